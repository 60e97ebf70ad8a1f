"""The chunk checker: accepts up to every bound, refuses beyond, believes nothing."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
from costs import cost_ratio
from hypothesis import given, settings
from hypothesis import strategies as st
from limit_motions import GRID_DT, HALF, LAB, MIDDLE, Chunk, joint_motion, motion, refused

from skewmi.deploy.safety.limits import (
    MAX_SAMPLES,
    ChunkChecker,
    LimitUsage,
)
from skewmi.errors import LimitViolationError
from skewmi.robot_models import limits, yumi
from skewmi.robot_models.kinematics import ArmKinematics


@pytest.fixture(scope="module")
def chunk() -> Chunk:
    """A good chunk in which every joint moves."""
    return motion(MIDDLE, MIDDLE + 0.1, LAB.velocity, LAB.acceleration, LAB.jerk)


@pytest.fixture(scope="module")
def checker() -> ChunkChecker:
    return ChunkChecker(LAB)


@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("bound", ["velocity", "acceleration", "jerk"])
def test_every_bound_is_sharp(checker: ChunkChecker, joint: int, sign: float, bound: str) -> None:
    # Far enough that the velocity bound is reached and held, for which jerk and acceleration
    # are reached before.
    usage = checker.check(*joint_motion(joint, 1.2 * sign, **{bound: 0.9999}))
    assert getattr(usage, bound) == pytest.approx(0.9999, rel=2e-3)
    error = refused(checker, joint_motion(joint, 1.2 * sign, **{bound: 1.002}))
    assert bound in error.limit
    assert f"joint index {joint}" in str(error)
    assert error.value > error.bound


@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_position_bounds_are_sharp(checker: ChunkChecker, joint: int, sign: float) -> None:
    # Between two samples the position may exceed them by A h^2 / 8.
    between = LAB.acceleration[joint] * GRID_DT**2 / 8
    usage = checker.check(*joint_motion(joint, sign * (HALF[joint] - 1.1 * between)))
    assert usage.position == pytest.approx(1.0, abs=1e-5)
    error = refused(checker, joint_motion(joint, sign * (HALF[joint] - 0.9 * between)))
    assert error.limit == "joint position"
    expected = (LAB.position_upper if sign > 0 else LAB.position_lower)[joint]
    assert error.bound == expected


def test_tail_counts(checker: ChunkChecker) -> None:
    """A chunk whose new samples are fine but which stops beyond a bound is refused."""
    q, v, a = joint_motion(0, HALF[0] + 0.01)
    assert (np.abs(q[:6] - MIDDLE) < HALF).all()
    assert refused(checker, (q, v, a)).limit == "joint position"


@settings(max_examples=150, deadline=None)
@given(
    which=st.integers(0, 2),
    row=st.floats(0.0, 1.0),
    joint=st.integers(0, 6),
    sign=st.sampled_from([-1.0, 1.0]),
)
def test_a_single_false_number_is_refused(which: int, row: float, joint: int, sign: float) -> None:
    """Any entry moved by more than what one grid step can explain: 2 J h^3 / 6 and so on."""
    arrays = list(motion(MIDDLE, MIDDLE + 0.1, LAB.velocity, LAB.acceleration, LAB.jerk))
    step = LAB.jerk[joint] * np.array([GRID_DT**3 / 3, GRID_DT**2, 2 * GRID_DT])[which]
    arrays[which] = arrays[which].copy()
    arrays[which][round(row * (len(arrays[0]) - 1)), joint] += sign * 1.01 * step
    with pytest.raises(LimitViolationError):
        ChunkChecker(LAB).check(*arrays)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("which", [0, 1, 2])
def test_numbers_must_be_finite(
    checker: ChunkChecker, chunk: Chunk, which: int, value: float
) -> None:
    arrays = [part.copy() for part in chunk]
    arrays[which][7, 3] = value
    assert refused(checker, tuple(arrays)).limit == "finite numbers"  # type: ignore[arg-type]


def test_hidden_position_jump_is_refused(checker: ChunkChecker) -> None:
    """Harmless velocities beside positions that jump."""
    q = np.tile(MIDDLE, (20, 1))
    q[10:, 2] += 0.001
    refused(checker, (q, np.zeros_like(q), np.zeros_like(q)))


def two_samples(dq: float, v0: float, a0: float) -> Chunk:
    """Joint 3 from (v0, a0) to rest within one grid step; in units of J h^3, J h^2 and J h."""
    unit = LAB.jerk[3] * GRID_DT
    q, v, a = (part.copy() for part in still(2))
    q[1, 3] += dq * unit * GRID_DT**2
    v[0, 3], a[0, 3] = v0 * unit * GRID_DT, a0 * unit
    return q, v, a


def still(n: int) -> Chunk:
    rows = np.tile(MIDDLE, (n, 1))
    return rows, np.zeros_like(rows), np.zeros_like(rows)


@pytest.mark.parametrize(
    ("dq", "v0", "a0", "broken"),
    [
        # |v1 - v0 - a0 h| / J h^2 is 0.49, then 0.51; backwards it is below 0.5.
        (-0.1, 0.3, -0.79, None),
        (-0.1, 0.3, -0.81, "velocity against acceleration"),
        # Backwards 0.49, then 0.51.
        (0.16, 0.49, -0.5, None),
        (0.16, 0.51, -0.5, "velocity against acceleration"),
        # |q1 - q0 - v0 h - a0 h^2 / 2| / J h^3 is 0.16, then 0.17; backwards below 1/6.
        (-0.11, 0.3, -0.5, None),
        (-0.12, 0.3, -0.5, "position against velocity"),
        # Backwards 0.16, then 0.17.
        (0.16, 0.3, -0.5, None),
        (0.17, 0.3, -0.5, "position against velocity"),
    ],
)
def test_samples_must_fit_each_other(
    checker: ChunkChecker, dq: float, v0: float, a0: float, broken: str | None
) -> None:
    chunk = two_samples(dq, v0, a0)
    previous = tuple(part[0] for part in chunk)
    if broken is None:
        checker.check(*chunk, previous)  # type: ignore[arg-type]
    else:
        assert refused(checker, chunk, previous=previous).limit == broken


def test_derivatives_cannot_be_left_out(checker: ChunkChecker, chunk: Chunk) -> None:
    q, v, _ = chunk
    assert refused(checker, (q, v, 0 * q)).limit == "velocity against acceleration"
    assert refused(checker, (q, 0 * q, 0 * q)).limit == "position against velocity"


def test_shapes(checker: ChunkChecker, chunk: Chunk) -> None:
    q, v, a = chunk
    for bad in ((q[:-1], v, a), (q, v[:, :6], a), (q[0], v[0], a[0]), (q, v, a[..., None])):
        assert refused(checker, bad).limit == "chunk shape"
    assert refused(checker, (q[-1:], v[-1:], a[-1:])).limit == "chunk samples"
    long = np.tile(MIDDLE, (MAX_SAMPLES + 1, 1))
    assert refused(checker, (long, 0 * long, 0 * long)).limit == "chunk samples"


@pytest.mark.parametrize("which", [1, 2])
def test_must_end_at_rest(checker: ChunkChecker, chunk: Chunk, which: int) -> None:
    cut = tuple(part[: len(chunk[0]) // 2] for part in chunk)
    assert "at the end" in refused(checker, cut).limit  # type: ignore[arg-type]
    arrays = [part.copy() for part in chunk]
    arrays[which][-1, 5] = 1e-6
    assert "at the end" in refused(checker, tuple(arrays)).limit  # type: ignore[arg-type]


def test_splice(checker: ChunkChecker, chunk: Chunk) -> None:
    later = tuple(part[8:] for part in chunk)
    here = tuple(part[8] for part in chunk)
    checker.check(*later, here)  # type: ignore[arg-type]
    assert "first start" in refused(checker, later).limit  # type: ignore[arg-type]
    for i, jump in enumerate((1e-6, 1e-4, 1e-2)):
        moved = [part.copy() for part in here]
        moved[i][4] += jump
        assert "splice" in refused(checker, later, previous=tuple(moved)).limit  # type: ignore[arg-type]
    broken = [part.copy() for part in here]
    broken[0][0] = np.nan
    refused(checker, later, previous=tuple(broken))  # type: ignore[arg-type]


def test_usage_merges_and_lists() -> None:
    merged = LimitUsage(velocity=0.5, jerk=0.1).merged(LimitUsage(velocity=0.2, jerk=0.3))
    assert (merged.velocity, merged.jerk) == (0.5, 0.3)
    assert merged.as_dict()["velocity"] == 0.5


def test_profiles_agree_with_the_robot() -> None:
    """What the checker restates of the robot stays inside ABB's own bounds."""
    for name in limits.PROFILES:
        profile = limits.profile(name)
        assert (profile.position_lower > yumi.POSITION_LOWER).all()
        assert (profile.position_upper < yumi.POSITION_UPPER).all()
        assert (profile.velocity <= yumi.VELOCITY).all()


def test_imports_nothing_of_the_planner() -> None:
    code = (
        "import sys, skewmi.deploy.safety.limits; "
        "names = 'mink', 'ruckig', 'pinocchio', 'mujoco', 'skewmi.deploy.motion'; "
        "print([m for m in names if m in sys.modules])"
    )
    out = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout
    assert out.strip() == "[]"


def test_checking_is_cheap() -> None:
    """A third of what the kinematics take for the same samples; 1 ms of a slow computer."""
    chunk = motion(MIDDLE, MIDDLE + 0.1, LAB.velocity, LAB.acceleration, LAB.jerk)
    forward = ArmKinematics("right").forward
    check: Callable[..., LimitUsage] = ChunkChecker(LAB, forward=forward, tcp_speed=10.0).check
    ratio = cost_ratio(lambda: check(*chunk), lambda: [forward(q) for q in chunk[0]], 50)
    assert ratio < 0.9
