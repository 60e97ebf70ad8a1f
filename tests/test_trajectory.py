"""Joint trajectories: slices, joins, and what lies between the samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.safety import limits as restated
from skewmi.errors import ConfigurationError
from skewmi.robot_models import limits, yumi
from skewmi.trajectory import (
    CYCLE_NS,
    CYCLE_S,
    CYCLE_TICKS,
    GRID_NS,
    GRID_S,
    Array,
    JointPoint,
    JointTrajectory,
    TrajectoryChunk,
)

LAB = limits.profile("lab")
HOME = np.array(yumi.HOME["right"])
START = HOME + np.linspace(0.3, -0.3, 7)


def polynomial(coefficients: Array, times_s: Array) -> JointTrajectory:
    """Samples of one polynomial per joint. Shapes (degree + 1, d), (n,)."""
    values = [np.polynomial.polynomial.polyval(times_s, coefficients).T]
    for order in (1, 2):
        derived = np.polynomial.polynomial.polyder(coefficients, order)
        values.append(np.polynomial.polynomial.polyval(times_s, derived).T)
    return JointTrajectory(*values)


def test_one_grid_and_one_cycle() -> None:
    assert CYCLE_TICKS * GRID_NS == CYCLE_NS
    assert (GRID_S, CYCLE_S) == (0.004, 0.02)
    # The limits judge by a grid of their own, which must be the same.
    assert restated.GRID_DT == GRID_S


@settings(deadline=None)
@given(seed=st.integers(0, 1000), degree=st.integers(0, 5), time_ns=st.integers(0, 5 * GRID_NS))
def test_polynomials_up_to_degree_five_are_sampled_exactly(
    seed: int, degree: int, time_ns: int
) -> None:
    rng = np.random.default_rng(seed)
    coefficients = rng.normal(size=(degree + 1, 3)) * 10.0 ** (2 * np.arange(degree + 1)[:, None])
    # Rounding of a position shows in the acceleration between two samples, times 60 / h^2.
    rounding = 60.0 / GRID_S**2 * np.finfo(float).eps * max(1.0, np.abs(coefficients[0]).max())
    samples = polynomial(coefficients, GRID_S * np.arange(6))
    expected = polynomial(coefficients, np.array([time_ns / 1e9])).point(0)
    for got, wanted in zip(samples.at(time_ns), expected, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=10.0 * rounding)


def test_on_the_grid_the_samples_themselves_are_given() -> None:
    motion = StartMotion(HOME, START, LAB).trajectory
    for index in range(len(motion)):
        got = motion.at(index * GRID_NS)
        for part, samples in zip(got, (motion.q, motion.v, motion.a), strict=True):
            assert part.base is samples or part.base is samples.base
            np.testing.assert_array_equal(part, samples[index])


def test_before_and_after_the_motion_rests_at_its_ends() -> None:
    motion = StartMotion(HOME, START, LAB).trajectory
    for time_ns in (-(10**18), -GRID_NS, -1):
        np.testing.assert_array_equal(motion.at(time_ns).q, HOME)
    end_ns = (len(motion) - 1) * GRID_NS
    assert motion.duration_s == end_ns / 1e9
    for time_ns in (end_ns, end_ns + 1, 10**18):
        np.testing.assert_array_equal(motion.at(time_ns).q, START)
        assert not motion.at(time_ns).v.any()


@pytest.mark.parametrize("period_ns", [4_032_000, 3_999_999, 5_000_000, 12_345_678])
def test_between_the_samples_the_motion_is_as_smooth_as_on_them(period_ns: int) -> None:
    """Whatever the robot's cycle: by differences of positions alone every limit holds."""
    motion = StartMotion(HOME, START, LAB).trajectory
    times = range(-5 * period_ns, len(motion) * GRID_NS + 5 * period_ns, period_ns)
    q = np.array([motion.at(time_ns).q for time_ns in times])
    h = period_ns / 1e9
    # Where the jerk switches between two samples, the polynomial is not the planned motion: its
    # differences may exceed the bound, by parts in ten thousand.
    for order, bound in ((1, LAB.velocity), (2, LAB.acceleration), (3, LAB.jerk)):
        peak = np.abs(np.diff(q, n=order, axis=0)).max(axis=0) / h**order
        assert (peak <= bound * (1 + 1e-3)).all(), (order, peak / bound)


def test_parts_and_joins() -> None:
    motion = StartMotion(HOME, START, LAB).trajectory
    first, second = motion.part(slice(0, 10)), motion.part(slice(10, None))
    joined = JointTrajectory.concatenate(first, second)
    for name in "qva":
        np.testing.assert_array_equal(getattr(joined, name), getattr(motion, name))
    picked = motion.part(np.array([3, 3, 5]))
    np.testing.assert_array_equal(picked.q, motion.q[[3, 3, 5]])
    assert list(motion.times_ns[:3]) == [0, GRID_NS, 2 * GRID_NS]


def test_the_rest_of_a_motion_is_padded_with_its_end() -> None:
    q = np.arange(4.0)[:, None] * np.ones((4, 7))
    rest = JointTrajectory(q, 0 * q, 0 * q).rest_of(2, 6)
    np.testing.assert_array_equal(rest.q[:, 0], [2.0, 3.0, 3.0, 3.0, 3.0, 3.0])
    longer = JointTrajectory(q, 0 * q, 0 * q).rest_of(1, 2)
    np.testing.assert_array_equal(longer.q[:, 0], [1.0, 2.0, 3.0])


@pytest.mark.parametrize("padding", [0, 1, 7])
def test_rest_begins_where_nothing_changes_any_more(padding: int) -> None:
    motion = StartMotion(HOME, START, LAB).trajectory
    assert motion.rest_of(0, len(motion) + padding).rest_ns == (len(motion) - 1) * GRID_NS
    assert JointTrajectory.resting(HOME, 1 + padding).rest_ns == 0


@pytest.mark.parametrize(
    "shapes", [((2, 7), (2, 7), (3, 7)), ((2, 7), (2, 6), (2, 7)), ((7,),) * 3]
)
def test_shapes_that_disagree_are_refused(shapes: tuple[tuple[int, ...], ...]) -> None:
    with pytest.raises(ConfigurationError, match="same shape"):
        JointTrajectory(*map(np.zeros, shapes))


def test_a_chunk_says_when_each_sample_is_due() -> None:
    chunk = TrajectoryChunk.of(7, ("a", "b"), JointTrajectory.resting(np.zeros(2), 3))
    assert chunk.time_from_start_ns.tolist() == [0, 4_000_000, 8_000_000]


def test_points_come_apart() -> None:
    q, v, a = JointPoint(np.zeros(7), np.ones(7), 2 * np.ones(7))
    assert (q[0], v[0], a[0]) == (0.0, 1.0, 2.0)
