"""Each rule of a workspace on its own: ways in, heights, what a scene permits, odd numbers."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lone_motions import LAB

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.safety.flange_space import (
    CALIBRATION,
    CLEAR_HIGH,
    FINGER_TIP,
    HEADROOM,
    TOUCH,
    FlangeSpace,
    SpaceCheck,
    flange_spaces,
    lowest_of_hand,
)
from skewmi.errors import ConfigurationError, LimitViolationError
from skewmi.policy_io import Array
from skewmi.robot_models import yumi
from skewmi.robot_models.frames import HAND_DOWN
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.obstacle import Obstacle
from skewmi.sim.tasks.open_press_close.definition import make_layout
from skewmi.trajectory import JointPoint, JointTrajectory

WORKSPACE = make_layout().workspace
assert WORKSPACE is not None
BOX = Obstacle((0.391, -0.0735, 0.06), (0.109, 0.0765, 0.06))
SPACES = flange_spaces(WORKSPACE, (BOX,))
ARM = ArmKinematics("right")
START, HOME = np.array(yumi.TABLE_CONFIGURATION), np.array(yumi.HOME["right"])
SERVER = {name: SpaceCheck(LAB, space, ARM.forward) for name, space in SPACES.items()}
LOW = np.array([0.391, -0.075, 0.2])
"""Where the hand presses the button: its fingers are in the box."""


def configuration(position: Array) -> Array:
    """Hand down at a point of the base frame, rad. Shape (7,)."""
    result = ARM.inverse(position[None], HAND_DOWN, START[None], posture=START, max_iterations=100)
    assert result.position_error[0] < 1e-3
    return np.asarray(result.q[0])


def go(check: SpaceCheck, start: Array, goal: Array, speed: float = 0.2) -> None:
    """Judge the whole way from rest to rest, in one piece."""
    motion = StartMotion(start, goal, LAB, flange_speed=speed).trajectory
    check(motion, JointPoint(start, np.zeros(7), np.zeros(7)), np.tile(start, (3, 1)))


def test_from_home_the_way_in_is_open_and_there_is_none_out() -> None:
    raised = configuration(np.array([0.391, -0.1345, 0.33]))
    go(SERVER[CALIBRATION], HOME, raised)
    with pytest.raises(LimitViolationError, match="outside the workspace"):
        go(SERVER[CALIBRATION], raised, HOME)


@pytest.mark.parametrize("name", SPACES)
def test_who_comes_in_may_not_go_out_again_in_the_same_motion(name: str) -> None:
    space = replace(SPACES[name], low=(0.20, -0.19, 0.17), high=(0.58, -0.16, 0.56), speed=0.25)
    check = SpaceCheck(LAB, replace(space, fingers_above=0.0), ARM.forward)
    beside, across = (configuration(np.array([0.391, y, 0.33])) for y in (-0.134, -0.22))
    go(SERVER[CALIBRATION], beside, across)
    with pytest.raises(LimitViolationError, match="outside the workspace"):
        go(check, beside, across)
    go(check, beside, configuration(np.array([0.391, -0.175, 0.33])))


def test_a_hand_that_stands_low_may_go_on_and_up_but_not_down() -> None:
    check, low = SERVER[CALIBRATION], configuration(LOW)
    go(check, low, configuration(LOW + np.array([0.0, 0.0, 0.1])))
    go(check, low, low)
    with pytest.raises(LimitViolationError, match="height of the fingers"):
        go(check, low, configuration(LOW - np.array([0.0, 0.0, 0.01])))
    # Where it is up, it stays up, within one motion, too.
    up = configuration(np.array([0.391, -0.1345, 0.33]))
    with pytest.raises(LimitViolationError, match="height of the fingers"):
        go(check, up, low)
    go(SERVER[TOUCH], low, configuration(LOW - np.array([0.0, 0.0, 0.01])), 0.004)


def test_nothing_but_a_slow_hand_touches() -> None:
    check, low = SERVER[TOUCH], configuration(LOW)
    go(check, low, configuration(LOW + np.array([0.0, 0.005, 0.0])), 0.0095)
    with pytest.raises(LimitViolationError, match="speed"):
        go(check, low, configuration(LOW + np.array([0.0, 0.03, 0.0])), 0.0105)
    # About its own axis the fingers' middle stays where it is; tilted about the flange it moves.
    with pytest.raises(LimitViolationError, match="speed"):
        go(check, low, low + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.0]), 0.2)


@settings(deadline=None, max_examples=200)
@given(st.integers(0, 2**32))
def test_the_lowest_of_the_hand_is_below_all_of_its_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = rng.uniform(LAB.position_lower, LAB.position_upper, (4, 7))
    position, rotation = ARM.forward(q)
    opening, width = rng.uniform(0.0, yumi.GRIPPER.travel), yumi.GRIPPER.finger_size
    outer = opening + width[0]
    points = [(0.0, 0.0, 0.0), (0.0, 0.0, yumi.GRIPPER.base_length)]
    points += [(x, y, FINGER_TIP) for x in (-outer, outer) for y in (-width[1] / 2, width[1] / 2)]
    heights = position[:, 2, None] + rotation[:, 2] @ np.array(points).T
    lowest = lowest_of_hand(position, rotation)
    assert (lowest <= heights.min(axis=1) + 1e-9).all()
    assert (lowest >= position[:, 2] - 0.147).all(), "from which the space's floor comes"


def test_scenes_that_leave_no_room_are_not_offered() -> None:
    assert flange_spaces(None, (BOX,)) == {}
    assert flange_spaces(WORKSPACE, ()) == {}
    tallest = CLEAR_HIGH[2] - HEADROOM - FINGER_TIP - 0.010
    for height, offered in ((tallest - 0.001, 2), (tallest + 0.001, 0)):
        tall = Obstacle((0.4, 0.0, height / 2), (0.1, 0.1, height / 2))
        assert len(flange_spaces(WORKSPACE, (BOX, tall))) == offered
    x, y, z = WORKSPACE.high
    assert flange_spaces(replace(WORKSPACE, high=(x, y + 0.1, z)), (BOX,)) == {}


@pytest.mark.parametrize(
    "change",
    [
        {"low": (0.6, 0.0, 0.2)},
        {"low": (float("nan"), 0.0, 0.2)},
        {"high": (1.0, 1.0)},
        {"speed": 0.0},
        {"speed": float("inf")},
        {"fingers_above": float("nan")},
    ],
)
def test_what_is_no_space_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(ConfigurationError, match="workspace 'calibration'"):
        FlangeSpace(**{**vars(SPACES[CALIBRATION]), **change})


def test_two_samples_are_enough_to_be_judged() -> None:
    rest = JointPoint(START, np.zeros(7), np.zeros(7))
    for check in SERVER.values():
        check(JointTrajectory.resting(START, 2), rest, np.tile(START, (3, 1)))


def judge_whole(check: SpaceCheck, *goals: Array) -> None:
    """From rest to rest through goals, resting at each, in one piece."""
    motion = StartMotion(goals[0], goals[1], LAB, flange_speed=0.2).trajectory
    for start, goal in pairwise(goals[1:]):
        further = StartMotion(start, goal, LAB, flange_speed=0.2).trajectory
        motion = JointTrajectory.concatenate(motion, further)
    rest = JointPoint(goals[0], np.zeros(7), np.zeros(7))
    check(motion, rest, np.tile(goals[0], (3, 1)))


def test_up_and_down_again_is_down() -> None:
    low, up = configuration(LOW), configuration(LOW + np.array([0.0, 0.0, 0.1]))
    judge_whole(SERVER[CALIBRATION], low, up)
    with pytest.raises(LimitViolationError, match="height of the fingers"):
        judge_whole(SERVER[CALIBRATION], low, up, configuration(LOW + np.array([0, 0, 0.03])))


def test_nobody_comes_in_low_from_beside() -> None:
    space = replace(SPACES[CALIBRATION], low=(0.2, -0.19, 0.17))
    low, high = (configuration(np.array([0.391, -0.21, z])) for z in (0.2, 0.33))
    inside_low, inside = (configuration(np.array([0.391, -0.16, z])) for z in (0.22, 0.33))
    check = SpaceCheck(LAB, space, ARM.forward)
    go(check, high, inside)
    with pytest.raises(LimitViolationError, match="height of the fingers"):
        go(check, low, inside_low)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("upper", [True, False])
def test_the_box_and_its_tolerance_are_kept_to_the_micrometre(axis: int, upper: bool) -> None:
    """The side is put where the motion ends, or begins, and a little more or less."""
    start = configuration(np.array([0.40, -0.12, 0.35]))
    step = np.zeros(3)
    step[axis] = 0.02 if upper else -0.02
    goal = configuration(np.array([0.40, -0.12, 0.35]) + step)
    motion = StartMotion(start, goal, LAB, flange_speed=0.2).trajectory
    along = ARM.forward(motion.q)[0][:, axis]
    reached, began = (along.max(), along[0]) if upper else (along.min(), along[0])
    free = replace(SPACES[CALIBRATION], fingers_above=0.0)

    def check(side: float, samples: JointTrajectory) -> None:
        corner = list(free.high if upper else free.low)
        corner[axis] = side
        space = replace(free, **{"high" if upper else "low": tuple(corner)})
        rest = JointPoint(samples.q[0], np.zeros(7), np.zeros(7))
        SpaceCheck(LAB, space, ARM.forward)(samples, rest, np.tile(samples.q[0], (3, 1)))

    out = 1.0 if upper else -1.0
    check(reached - out * (0.005 - 1e-7), motion)
    with pytest.raises(LimitViolationError, match=f"axis {'xyz'[axis]}"):
        check(reached - out * (0.005 + 1e-7), motion)
    # Where splices and rounding may put a hand that was inside, it is still inside.
    with pytest.raises(LimitViolationError, match=f"axis {'xyz'[axis]}"):
        check(began - out * (0.005 + 5e-7), motion)
    check(began - out * (0.005 + 2e-6), motion)
