"""Motion to the start: straight in joint space, inside all limits, able to stop anywhere."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from slow_limits import slowed

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.safety.limits import ChunkChecker, LimitUsage
from skewmi.errors import ConfigurationError, LimitViolationError
from skewmi.policy_io import Array
from skewmi.robot_models import limits, yumi
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import CYCLE_TICKS

HOME = np.array(yumi.HOME["right"])
START = np.array(yumi.TABLE_CONFIGURATION)
FORWARD = ArmKinematics("right").forward


def run(motion: StartMotion, bounds: limits.JointLimits) -> LimitUsage:
    """Check every chunk against the one before; return the use of the limits."""
    checker = ChunkChecker(bounds, None, FORWARD)
    usage, state = LimitUsage(), None
    for chunk in motion.chunks():
        usage = usage.merged(checker.check(chunk.q, chunk.v, chunk.a, state))
        if state is not None:
            assert all(
                np.array_equal(x[0], y)
                for x, y in zip((chunk.q, chunk.v, chunk.a), state, strict=True)
            )
        state = chunk.point(CYCLE_TICKS)
    np.testing.assert_array_equal(chunk.q[-1], motion.trajectory.q[-1])
    return usage


def straightness(q: Array) -> float:
    """Largest distance of samples from the line between the ends, rad."""
    line = q[-1] - q[0]
    along = (q - q[0]) @ line / (line @ line)
    return float(np.abs(q - q[0] - along[:, None] * line).max())


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    name=st.sampled_from(sorted(limits.PROFILES)),
    speed=st.sampled_from([1.0, 0.5, 0.1]),
)
@example(seed=131072, name="lab", speed=1.0)  # stopping joint by joint made the tool faster
def test_any_motion_keeps_all_limits(seed: int, name: str, speed: float) -> None:
    rng = np.random.default_rng(seed)
    bounds = slowed(limits.profile(name), speed)
    start = rng.uniform(bounds.position_lower + 1e-3, bounds.position_upper - 1e-3)
    reach = 10 ** rng.uniform(-4, 0.3)
    end = np.clip(
        start + reach * rng.normal(size=7),
        bounds.position_lower + 1e-3,
        bounds.position_upper - 1e-3,
    )
    motion = StartMotion(start, end, bounds)
    run(motion, bounds)
    np.testing.assert_array_equal(motion.trajectory.q[0], start)
    np.testing.assert_array_equal(motion.trajectory.q[-1], end)


@pytest.mark.parametrize("name", sorted(limits.PROFILES))
def test_uses_what_it_may(name: str) -> None:
    """Velocity, acceleration, jerk or tool speed: at least one is nearly used up."""
    bounds = limits.profile(name)
    motion = StartMotion(HOME, START, bounds)
    usage = run(motion, bounds)
    assert max(usage.velocity, usage.tcp_speed) > 0.9
    assert straightness(motion.trajectory.q) < 1e-9


def test_speed_scale_takes_longer() -> None:
    bounds = limits.profile("careful")
    fast = StartMotion(HOME, START, bounds)
    slow = StartMotion(HOME, START, slowed(bounds, 0.5))
    assert slow.trajectory.duration_s > 1.5 * fast.trajectory.duration_s


def test_stops_by_itself_from_every_chunk() -> None:
    """A dead sender: the tail of any chunk is at rest within a fraction of a second."""
    motion = StartMotion(HOME, START, limits.profile("lab"))
    for chunk in motion.chunks():
        assert not chunk.v[-1].any()
        assert not chunk.a[-1].any()
        assert len(chunk.q) * 0.004 < 0.2


def test_no_motion_is_a_motion() -> None:
    motion = StartMotion(START, START, limits.profile("lab"))
    assert motion.cycles == 1
    chunk = motion.chunk(0)
    assert len(chunk.q) >= 6
    np.testing.assert_array_equal(chunk.q, np.tile(START, (len(chunk.q), 1)))
    # Afterwards the arm rests.
    np.testing.assert_array_equal(motion.chunk(100).q[0], START)


@pytest.mark.parametrize("which", ["start", "end"])
def test_refuses_configurations_outside(which: str) -> None:
    good, bounds = START, limits.profile("lab")
    for bad in (
        np.full(7, np.nan),
        START[:6],
        bounds.position_upper + 1e-6,
        bounds.position_lower - 1e-6,
    ):
        ends = (bad, good) if which == "start" else (good, bad)
        with pytest.raises(LimitViolationError, match=which):
            StartMotion(*ends, bounds)


def test_configuration_errors() -> None:
    bounds = limits.profile("lab")
    with pytest.raises(ConfigurationError, match="negative"):
        StartMotion(HOME, START, bounds).chunk(-1)
