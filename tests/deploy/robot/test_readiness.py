"""A robot may lack a scene, not be ready, be moved by hand, and refuse to be activated."""

from __future__ import annotations

import numpy as np
import pytest
from lone_robot import LoneRobot
from unready_robot import Unready

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.backend import RobotState
from skewmi.deploy.robot.backends.hold import HoldBackend
from skewmi.deploy.robot.controller import SILENCE_NS
from skewmi.deploy.robot.states import ServerState
from skewmi.errors import CommandRefusedError
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi

LAB = joint_limits.profile("lab")
HOME = np.array(yumi.HOME["right"])
AWAY = HOME + np.linspace(0.3, -0.3, 7)
OURS = b"a" * 16


@pytest.fixture
def unready() -> Unready:
    return Unready(HOME, lock_step=True)


def test_without_a_scene_there_is_nothing_to_reset() -> None:
    robot = LoneRobot(HoldBackend(HOME, lock_step=True), LAB)
    with pytest.raises(CommandRefusedError, match="'hold' has no scene"):
        robot.requests.reset_scene(0)


def test_arming_is_refused_for_the_reason_that_the_robot_gives(unready: Unready) -> None:
    robot = LoneRobot(unready, LAB)
    unready.missing = "the motors are off"
    with pytest.raises(CommandRefusedError, match="not ready: the motors are off"):
        robot.requests.arm(OURS, 0)
    assert robot.controller.lease.holder is None
    unready.missing = None
    robot.requests.arm(OURS, 0)
    assert robot.controller.state is ServerState.HOLDING


def test_a_robot_that_is_no_longer_ready_at_rest_is_disarmed(unready: Unready) -> None:
    robot = LoneRobot(unready, LAB)
    unready.missing = "the motors are off"
    robot.run(3)
    assert robot.controller.state is ServerState.DISARMED
    unready.missing = None
    robot.requests.arm(OURS, 0)
    robot.run(3)
    assert robot.controller.state is ServerState.HOLDING
    unready.missing = "the motors are off"
    robot.run(1)
    assert robot.controller.state is ServerState.DISARMED
    assert robot.controller.machine.reason == "the motors are off"
    assert robot.controller.lease.holder is None


@pytest.mark.parametrize("stopping", [False, True])
def test_a_robot_that_is_no_longer_ready_in_motion_is_a_fault(
    unready: Unready, stopping: bool
) -> None:
    robot = LoneRobot(unready, LAB)
    robot.requests.arm(OURS, 0)
    start = robot.commanded
    motion = StartMotion(start, start + 0.05, LAB).trajectory
    assert robot.controller.receive(robot.payload(motion, robot.due + 3), OURS, 1, 0)
    robot.run(10)
    if stopping:
        robot.requests.stop("test")
    unready.missing = "the motors are off"
    robot.run(1)
    assert robot.controller.state is ServerState.FAULT
    assert robot.controller.machine.reason == "the motors are off"
    # It still has cycles, so the plan is followed to its end.
    robot.run(300)
    assert robot.controller.at_rest


def test_a_robot_without_cycles_that_is_not_ready_forgets_its_plan(unready: Unready) -> None:
    robot = LoneRobot(unready, LAB)
    robot.requests.arm(OURS, 0)
    start = robot.commanded
    motion = StartMotion(start, start + 0.05, LAB).trajectory
    assert robot.controller.receive(robot.payload(motion, robot.due + 3), OURS, 1, 0)
    robot.run(10)
    robot.controller.no_cycle(SILENCE_NS)
    assert robot.controller.state is ServerState.EXECUTING, "it says nothing of being gone"
    unready.missing = "silent"
    robot.controller.no_cycle(SILENCE_NS - 1)
    assert robot.controller.state is ServerState.FAULT
    assert not robot.controller.at_rest
    robot.controller.no_cycle(SILENCE_NS)
    assert robot.controller.at_rest
    np.testing.assert_array_equal(robot.commanded, robot.measured[:7])


def test_an_arm_that_is_moved_by_hand_is_commanded_to_stay_where_it_is() -> None:
    class ByHand(HoldBackend):
        guided = True

        def read(self) -> RobotState | None:
            state = super().read()
            if state is None or self.guided:
                return state
            moved = state.position + 0.8
            return RobotState(state.time_ns, moved, state.velocity, state.effort, guided=False)

    backend = ByHand(HOME, lock_step=True)
    robot = LoneRobot(backend, LAB)
    backend.guided = False
    robot.run(2)
    assert robot.controller.state is ServerState.DISARMED, "no fault: nobody commands it"
    np.testing.assert_array_equal(robot.targets[-1].q, robot.measured[:7])
    np.testing.assert_array_equal(robot.commanded, robot.measured[:7])


def test_a_robot_that_was_moved_by_its_own_hand_can_be_told_so() -> None:
    robot = LoneRobot(HoldBackend(HOME, lock_step=True), LAB)
    robot.controller.reseed(HOME + 0.1)
    robot.run(1)
    np.testing.assert_array_equal(robot.targets[-1].q, HOME + 0.1)


def test_activation_frames_every_armed_stretch() -> None:
    told: list[str] = []

    class Telling(HoldBackend):
        def activate(self) -> None:
            told.append("activate")

        def deactivate(self) -> None:
            told.append("deactivate")

    robot = LoneRobot(Telling(HOME, lock_step=True), LAB)
    for _ in range(2):
        robot.requests.arm(OURS, 0)
        robot.requests.arm(OURS, 0)
        robot.requests.stop("test")
        robot.requests.stop("test")
    robot.requests.arm(OURS, 0)
    robot.controller.fault("a fan stands still")
    robot.requests.stop("test")
    assert told == ["activate", "deactivate"] * 3


def test_a_robot_that_refuses_to_be_activated_stays_disarmed() -> None:
    class Shy(HoldBackend):
        def activate(self) -> None:
            raise CommandRefusedError("the key switch is in manual")

    robot = LoneRobot(Shy(HOME, lock_step=True), LAB)
    with pytest.raises(CommandRefusedError, match="key switch"):
        robot.requests.arm(OURS, 0)
    assert robot.controller.state is ServerState.DISARMED
    assert robot.controller.lease.holder is None
