"""Motions known beforehand: whenever they end, they end at rest, on their path, within limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from skewmi.calibration.excitation import Excitation
from skewmi.calibration.excitation_choice import excitation_centre
from skewmi.deploy.motion.joint_path import JointPath, chebyshev_places
from skewmi.deploy.motion.path_motion import PathMotion
from skewmi.deploy.safety.limits import ChunkChecker, LimitUsage
from skewmi.errors import ConfigurationError, LimitViolationError
from skewmi.robot_models import limits, yumi
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import CYCLE_TICKS, GRID_S, Array, JointTrajectory, TrajectoryChunk

FORWARD = ArmKinematics("right").forward
SEEDS = (*range(25), 76, 101, 111, 152, 159, 162, 245, 350, 387, 416, 456, 527, 584)
"""Some, and those whose stops once were rougher between the samples than at them."""


def excitation(profile: str, seconds: float, seed: int) -> JointTrajectory:
    return Excitation(seconds, seed).motion(excitation_centre(), limits.profile(profile))


def usage_of(motion: PathMotion, profile: str) -> LimitUsage:
    """As the robot server looks at chunks: each from the plan that the one before it left."""
    checker = ChunkChecker(limits.profile(profile), None, FORWARD)
    usage, last = LimitUsage(), JointTrajectory.resting(motion.trajectory.q[0], 6)
    for cycle in range(motion.cycles):
        chunk = motion.chunk(cycle)
        earlier = last.q[CYCLE_TICKS - 3 : CYCLE_TICKS]
        previous = last.point(CYCLE_TICKS)
        usage = usage.merged(checker.check(chunk.q, chunk.v, chunk.a, previous, earlier=earlier))
        last = chunk
    return usage


@pytest.mark.parametrize("profile", ["lab", "careful"])
@settings(max_examples=4, deadline=None)
@example(seed=271, seconds=6.25)
@example(seed=840, seconds=8.15)
@given(seed=st.integers(0, 10_000), seconds=st.floats(5.0, 9.0))
def test_every_chunk_passes_the_checks_that_robot_servers_make(
    profile: str, seed: int, seconds: float
) -> None:
    motion = PathMotion(excitation(profile, seconds, seed), limits.profile(profile))
    usage = usage_of(motion, profile)
    assert max(usage.as_dict().values()) <= 1.0
    # It is not slow for nothing either.
    assert usage.acceleration > 0.9


def line_of_the_hand(seed: int) -> tuple[JointPath, float, float]:
    """A straight line near the scene, a place on it to begin at, and a speed."""
    generator = np.random.default_rng(seed)
    arm, posture = ArmKinematics("right"), np.array(yumi.TABLE_CONFIGURATION)
    middle, rotation = arm.forward(posture)
    begin = middle + generator.uniform(-0.05, 0.05, 3)
    end = middle + generator.uniform(-0.12, 0.12, 3)
    length = float(np.linalg.norm(end - begin))
    places = chebyshev_places(length, 10)
    points = begin + np.outer(places / length, end - begin)
    q = np.tile(posture, (len(points), 1))
    found = arm.inverse(points, np.tile(rotation, (len(points), 1, 1)), q, posture=q)
    assert found.position_error.max() < 1e-6
    near_the_end = 1.0 - 10 ** generator.uniform(-4, -1)
    part = generator.choice([0.0, generator.uniform(0.0, 0.98), near_the_end])
    return JointPath.through(found.q, length), part * length, generator.uniform(0.005, 0.25)


def test_lines_of_the_hand_from_anywhere_on_them_pass_those_checks() -> None:
    """A way that was left late is taken up from where the arm came to rest."""
    lab = limits.profile("lab")
    for seed in SEEDS:
        path, begin, speed = line_of_the_hand(seed)
        trajectory = path.motion(begin, path.length, lab, speed, 0.13, path.at(begin))
        usage = usage_of(PathMotion(trajectory, lab), "lab")
        assert max(usage.as_dict().values()) <= 1.0, seed


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 3), part=st.floats(0.0, 1.0))
def test_whenever_the_sender_falls_silent_the_arm_stops_on_the_path(seed: int, part: float) -> None:
    trajectory = excitation("lab", 6.0, seed)
    motion = PathMotion(trajectory, limits.profile("lab"))
    cycle = round(part * (motion.cycles - 1))
    chunk = motion.chunk(cycle)
    assert not chunk.v[-1].any()
    assert not chunk.a[-1].any()
    assert len(TrajectoryChunk.of(0, ("",) * 7, chunk).time_from_start_ns) <= 500
    fine = np.array([trajectory.at(k * 1_000_000).q for k in range(4 * (len(trajectory) - 1) + 1)])
    first = cycle * CYCLE_TICKS
    np.testing.assert_array_equal(
        chunk.q[: CYCLE_TICKS + 1], trajectory.rest_of(first, CYCLE_TICKS + 1).q[: CYCLE_TICKS + 1]
    )
    for q in chunk.q[CYCLE_TICKS + 1 :]:
        near = np.abs(fine - q).max(axis=1).min()
        # Half a millisecond of the fastest joint.
        assert near < 0.5e-3 * limits.profile("lab").velocity.max()


def test_the_stop_begins_where_the_motion_is_and_slows_down_from_there() -> None:
    trajectory = excitation("lab", 6.0, 1)
    motion = PathMotion(trajectory, limits.profile("lab"))

    def flange_speed(q: Array) -> Array:
        speed: Array = np.linalg.norm(np.diff(FORWARD(q)[0], axis=0), axis=1) / GRID_S
        return speed

    fastest = flange_speed(trajectory.q).max()
    for cycle in range(0, motion.cycles, 7):
        assert flange_speed(motion.chunk(cycle).q).max() <= fastest * 1.0001


def test_a_motion_that_cannot_be_stopped_is_refused_before_it_begins() -> None:
    trajectory = excitation("lab", 5.0, 0)
    narrow = limits.profile("careful")
    with pytest.raises(LimitViolationError, match="of the motion"):
        PathMotion(trajectory, narrow)


def test_a_motion_begins_and_ends_at_rest() -> None:
    trajectory = excitation("lab", 5.0, 0)
    for part, word in ((slice(400, None), "begins"), (slice(0, 400), "ends")):
        with pytest.raises(ConfigurationError, match=word):
            PathMotion(trajectory.part(part), limits.profile("lab"))
    with pytest.raises(ConfigurationError, match="negative"):
        PathMotion(trajectory, limits.profile("lab")).chunk(-1)
