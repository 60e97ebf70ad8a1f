"""Stops: as fast as ruckig's, at rest at the end, inside the reported extent."""

from __future__ import annotations

import numpy as np
import ruckig
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.motion.brake import ApproachSpeed, Array, plan_stop

GRID_DT = 0.004


def random_state(seed: int) -> tuple[Array, Array, Array, Array, Array]:
    """Position, velocity, acceleration and bounds of seven axes over many magnitudes."""
    rng = np.random.default_rng(seed)
    acceleration, jerk = 10 ** rng.uniform(-1, 2, 7), 10 ** rng.uniform(0, 3.5, 7)
    v = rng.normal(size=7) * 10.0 ** rng.uniform(-6, 1)
    a = acceleration * rng.uniform(-1, 1, 7) * rng.choice([0.0, 1e-3, 1.0, 1.0], 7)
    # Now and then exactly on the bound.
    a = np.where(rng.random(7) < 0.1, np.sign(a) * acceleration, a)
    return rng.normal(size=7), v, a, acceleration, jerk


def ruckig_stop(
    q: Array, v: Array, a: Array, acceleration: Array, jerk: Array
) -> ruckig.Trajectory:
    request = ruckig.InputParameter(7)
    request.control_interface = ruckig.ControlInterface.Velocity
    request.synchronization = ruckig.Synchronization.No
    request.current_position, request.current_velocity = q.tolist(), v.tolist()
    request.current_acceleration = a.tolist()
    request.max_acceleration, request.max_jerk = acceleration.tolist(), jerk.tolist()
    trajectory = ruckig.Trajectory(7)
    ruckig.Ruckig(7).calculate(request, trajectory)
    return trajectory


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_stops_like_ruckig(seed: int) -> None:
    state = random_state(seed)
    stop, reference = plan_stop(*state), ruckig_stop(*state)
    np.testing.assert_allclose(
        stop.start_s[3], reference.independent_min_durations, rtol=1e-9, atol=1e-9
    )
    q, v, a = stop.sample(GRID_DT)
    for k in np.linspace(0, len(q) - 1, 8).astype(int):
        expected = np.array(reference.at_time(GRID_DT * (k + 1)))
        np.testing.assert_allclose(np.array([q[k], v[k], a[k]]), expected, rtol=1e-7, atol=1e-7)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_rests_at_the_end_within_the_bounds_and_the_extent(seed: int) -> None:
    q0, v0, a0, acceleration, jerk = random_state(seed)
    stop = plan_stop(q0, v0, a0, acceleration, jerk)
    fine = max(stop.duration / 3000, 1e-6)
    q, v, a = stop.sample(fine)
    assert not v[-1].any()
    assert not a[-1].any()
    assert (np.abs(a) <= acceleration * (1 + 1e-12)).all()
    assert (np.abs(np.diff(a, axis=0)) <= jerk * fine * (1 + 1e-9) + 1e-9).all()
    low, high = stop.extent()
    rounding = 1e-9 * (high - low) + 1e-14 * (1.0 + np.abs(q0))
    assert (q.min(axis=0) >= low - rounding).all()
    assert (q.max(axis=0) <= high + rounding).all()
    # The extent is reached up to what lies between two samples, not just an upper bound.
    between = np.maximum(np.abs(v).max(axis=0), np.abs(v0)) * fine + acceleration * fine**2
    assert (np.minimum(q.min(axis=0), q0) <= low + between + rounding).all()
    assert (np.maximum(q.max(axis=0), q0) >= high - between - rounding).all()


def test_resting_axes_stay() -> None:
    q = np.arange(7.0)
    stop = plan_stop(q, np.zeros(7), np.zeros(7), np.ones(7), np.ones(7))
    samples, v, a = stop.sample(GRID_DT)
    assert stop.duration == 0.0
    np.testing.assert_array_equal(samples, q[None])
    assert not v.any()
    assert not a.any()


@settings(max_examples=200, deadline=None)
@given(st.floats(0.0, 5.0), st.floats(0.1, 100.0), st.floats(1.0, 5000.0))
def test_approach_speed_can_be_stopped_within_the_distance(
    distance: float, acceleration: float, jerk: float
) -> None:
    bounds = np.array([acceleration]), np.array([jerk])
    speed = ApproachSpeed(*bounds)(np.array([distance]))
    zero = np.zeros(1)
    _, high = plan_stop(zero, speed, zero, *bounds).extent()
    assert 0.0 <= high[0] <= distance + 1e-12


def test_no_approach_beyond_the_bound() -> None:
    assert not ApproachSpeed(np.ones(2), np.ones(2))(np.array([0.0, -1.0])).any()
