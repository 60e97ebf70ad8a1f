"""Whoever is in the box, or in the room that is left around it, cannot leave it."""

from __future__ import annotations

import numpy as np
import pytest
from fault_chunks import motion
from fault_motion import BOX_HIGH, BOX_LOW, BOX_ROOM, hand
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.safety.checks import limit_check
from skewmi.errors import LimitViolationError
from skewmi.policy_io import Array
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models.frames import rotation_from_quaternion
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.sim.tasks.open_press_close.definition import make_layout
from skewmi.trajectory import JointPoint, JointTrajectory

WORKSPACE = make_layout().workspace
assert WORKSPACE is not None
CHECK = limit_check(joint_limits.profile("lab"), WORKSPACE)
BASE = np.array(WORKSPACE.base_position)
POSTURE = np.array(WORKSPACE.start_configuration)
ROTATION = rotation_from_quaternion(WORKSPACE.hand_quaternion_wxyz)
SLOW = np.full(7, 0.2)


def configuration(position_w: Array) -> Array:
    """Joint angles that put the hand there, rad. Shape (7,)."""
    result = ArmKinematics("right").inverse(
        (position_w - BASE)[None], ROTATION, POSTURE[None], posture=POSTURE, max_iterations=100
    )
    return np.asarray(result.q[0])


def check(start: Array, goal: Array) -> object:
    """Judge a slow motion from rest to rest; also the judgement of its hand, m outside."""
    zero = np.zeros(7)
    q, v, a = motion((start, zero, zero), goal, SLOW, 10.0, 500.0)
    return CHECK(JointTrajectory(q, v, a), JointPoint(start, zero, zero), np.tile(start, (3, 1)))


@settings(max_examples=40, deadline=None)
@given(
    place=st.tuples(*[st.floats(0.0, 1.0)] * 3),
    axis=st.integers(0, 2),
    up=st.booleans(),
    outside=st.floats(0.0, 0.98),
)
def test_no_motion_leaves_from_the_room_around_the_box(
    place: tuple[float, float, float], axis: int, up: bool, outside: float
) -> None:
    at = BOX_LOW + np.array(place) * (BOX_HIGH - BOX_LOW)
    side, sign = (BOX_HIGH, 1.0) if up else (BOX_LOW, -1.0)
    at[axis] = side[axis] + sign * outside * BOX_ROOM
    beyond = at.copy()
    beyond[axis] = side[axis] + sign * 0.03
    start, goal = configuration(at), configuration(beyond)
    reached = hand(goal[None])[0]
    assert np.maximum(BOX_LOW - reached, reached - BOX_HIGH).max() > 2 * BOX_ROOM
    with pytest.raises(LimitViolationError, match="outside the workspace"):
        check(start, goal)


def test_from_far_outside_the_way_in_is_open() -> None:
    at = np.array(WORKSPACE.start)
    at[2] = BOX_HIGH[2] + 0.03
    check(configuration(at), POSTURE)
