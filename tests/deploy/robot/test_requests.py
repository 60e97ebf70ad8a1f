"""Who may command a robot, and what may be asked of it: commanders, strangers, gripper, scene."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lone_motions import (
    GRIPPER,
    OTHER,
    OURS,
    motion_from,
    start_moving,
)
from lone_robot import LoneRobot

from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.robot.controller import LEASE_NS
from skewmi.deploy.robot.refusals import Refusal
from skewmi.deploy.robot.requests import MOST_WAITING
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.safety.validation import MAX_CHUNK_BYTES, ValidationRules
from skewmi.deploy.wire.messages import JointStates
from skewmi.errors import CommandRefusedError
from skewmi.trajectory import GRID_NS, JointTrajectory


def test_second_commander_is_refused_with_the_reason(robot: LoneRobot) -> None:
    start_moving(robot)
    motion = motion_from(robot)
    assert not robot.controller.receive(robot.payload(motion, robot.due + 50), OTHER, 1, 0)
    assert "is not the commander" in robot.refusals()[0].reason
    with pytest.raises(CommandRefusedError, match="holds the arm"):
        robot.requests.arm(OTHER, 0)
    assert robot.controller.state is ServerState.EXECUTING


def test_arming_without_gids_makes_the_first_valid_sender_the_commander(
    robot: LoneRobot,
) -> None:
    robot.requests.arm(b"", 0)
    motion = motion_from(robot)
    assert robot.controller.receive(robot.payload(motion, 3), OTHER, 9, 0)
    assert not robot.controller.receive(robot.payload(motion, 60), OURS, 10, 0)


def test_silent_commander_loses_the_arm(robot: LoneRobot) -> None:
    start_moving(robot)
    robot.run(60, now_ns=LEASE_NS)
    assert robot.controller.state is ServerState.HOLDING
    robot.run(1, now_ns=LEASE_NS + 1)
    assert robot.controller.state is ServerState.DISARMED
    assert "no command for 2 s" in robot.controller.machine.reason
    robot.requests.arm(OTHER, LEASE_NS + 2)
    assert robot.controller.state is ServerState.HOLDING


def test_silence_is_noticed_before_what_comes_after_it(robot: LoneRobot) -> None:
    """The robot server itself may have been frozen: what was sent meanwhile waits for it."""
    motion = motion_from(robot)
    robot.requests.arm(OURS, 0)
    late = LEASE_NS + 1
    assert not robot.controller.receive(robot.payload(motion, robot.due + 3), OURS, 1, late)
    assert robot.controller.state is ServerState.DISARMED
    start_moving(robot)
    robot.run(10)
    with pytest.raises(CommandRefusedError, match="stopping"):
        robot.requests.arm(OTHER, late)
    assert robot.controller.state is ServerState.STOPPING


def test_arming_again_shows_that_one_is_there(robot: LoneRobot) -> None:
    robot.requests.arm(OURS + GRIPPER, 0)
    robot.requests.arm(OURS + OTHER, LEASE_NS)
    robot.run(1, 2 * LEASE_NS)
    assert robot.controller.state is ServerState.HOLDING
    robot.requests.open_gripper(0.01, OTHER)
    robot.run(1, 2 * LEASE_NS + 1)
    assert robot.controller.state is ServerState.DISARMED


def test_strangers_cost_little(robot: LoneRobot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of their messages is decoded, and nothing long of anybody's."""
    start_moving(robot)
    decoded = []
    monkeypatch.setattr(
        "skewmi.deploy.robot.controller.decode_chunk", lambda data: decoded.append(data)
    )
    assert not robot.controller.receive(b"anything", OTHER, 2, 0)
    assert not robot.controller.receive(bytes(MAX_CHUNK_BYTES + 1), OURS, 2, 0)
    assert decoded == []
    stranger, ours = robot.refusals()
    assert "not the commander" in stranger.reason
    assert "at most" in ours.reason
    monkeypatch.undo()
    for sequence in range(100):
        robot.controller.receive(b"x", OTHER, sequence, 0)
        robot.controller.receive(b"x", OURS, sequence, 0)
    assert robot.controller.refusals.count == 202
    kept = robot.refusals()
    assert sum(refusal.of_commander for refusal in kept) == 100
    assert len(kept) <= 132


@pytest.mark.parametrize("text", ["\x1b[2J[/bold] over\n\u202eand out", "a" * 100_000])
def test_what_strangers_say_is_told_in_one_short_line(robot: LoneRobot, text: str) -> None:
    start_moving(robot)
    robot.run(10)
    robot.requests.stop(text)
    robot.controller.refusals.note(Refusal(text))
    for told in (robot.controller.machine.reason, robot.refusals()[0].reason):
        assert len(told) < 400
        assert told.isprintable()
        assert text[5:20].isprintable() is False or text[5:20] in told


def test_the_longest_chunk_is_not_too_long(robot: LoneRobot) -> None:
    longest = JointTrajectory.resting(np.zeros(7), ValidationRules.max_points)
    assert len(robot.payload(longest, 0)) < MAX_CHUNK_BYTES


def test_gripper_commands_name_their_joint(robot: LoneRobot) -> None:
    robot.requests.arm(OURS, 0)
    finger, nothing = robot.backend.state_names[7], np.zeros(0)
    for names in ((), ("yumi_joint_1_r",), (finger, "yumi_joint_1_r")):
        command = JointStates(
            robot.controller.clock_ns, names, np.full(len(names), 0.02), nothing, nothing
        )
        with pytest.raises(CommandRefusedError, match=f"that of {finger}, is expected"):
            robot.requests.follow_gripper(command, GRIPPER, 1)
    with pytest.raises(CommandRefusedError, match="outside"):
        robot.requests.open_gripper(1.0, OTHER)
    assert robot.controller.lease.gripper_holder is None, "who said nonsense is no commander"
    command = JointStates(robot.controller.clock_ns, (finger,), np.array([0.02]), nothing, nothing)
    robot.requests.follow_gripper(command, GRIPPER, 1)
    assert robot.controller.lease.gripper_holder == GRIPPER


def test_a_scene_that_somebody_works_in_is_not_reset(robot: LoneRobot) -> None:
    robot.requests.arm(OURS, 0)
    robot.requests.reset_scene(1)
    motion = motion_from(robot)
    assert robot.controller.receive(robot.payload(motion, robot.due + 3), OURS, 1, 0)
    robot.run(len(motion.q) + 10)
    assert robot.controller.state is ServerState.HOLDING
    with pytest.raises(CommandRefusedError, match="works in the scene"):
        robot.requests.reset_scene(1)
    robot.requests.disarm(OURS)
    robot.requests.reset_scene(1)


def test_scene_resets_at_rest_only(robot: LoneRobot, simulation: ArmSimulation) -> None:
    start_moving(robot)
    robot.run(10)
    with pytest.raises(CommandRefusedError, match="moving"):
        robot.requests.reset_scene(1)
    robot.run(60)
    robot.requests.disarm(OURS)
    simulation._data.qpos[simulation.scene.scene_qpos[0]] = 1.0
    robot.requests.reset_scene(1)
    assert simulation.scene_state().position[0] == 0.0
    measured = simulation.robot_state(0).position[:7]
    assert robot.commanded == pytest.approx(measured, abs=1e-12)


def opening_for(robot: LoneRobot, ticks: int, opening: float) -> JointStates:
    """A gripper command for so many grid steps from now."""
    finger, nothing = robot.backend.state_names[7:], np.zeros(0)
    stamp_ns = robot.controller.clock_ns + ticks * GRID_NS
    return JointStates(stamp_ns, finger, np.array([opening]), nothing, nothing)


def finger_target(simulation: ArmSimulation) -> float:
    return simulation._finger_target


@pytest.mark.parametrize("delay", [0, 3, 5])
def test_in_lock_step_the_fingers_wait_for_their_time(
    robot: LoneRobot, simulation: ArmSimulation, delay: int
) -> None:
    """Whenever the command came on the way to it."""
    assert robot.backend.lock_step
    robot.requests.arm(OURS + GRIPPER, 0)
    before, first, second = (
        finger_target(simulation),
        *(opening_for(robot, 6 + more, opening) for more, opening in ((0, 0.02), (2, 0.01))),
    )
    robot.run(delay)
    # The later one first: each has its own time.
    robot.requests.follow_gripper(second, GRIPPER, 1)
    robot.requests.follow_gripper(first, GRIPPER, 2)
    robot.run(5 - delay)
    assert finger_target(simulation) == before
    robot.run(1)
    assert finger_target(simulation) == 0.02
    robot.run(1)
    assert finger_target(simulation) == 0.02
    robot.run(1)
    assert finger_target(simulation) == 0.01


def test_fingers_that_wait_obey_the_commander_only_and_no_more_once_it_is_gone(
    robot: LoneRobot, simulation: ArmSimulation
) -> None:
    with pytest.raises(CommandRefusedError, match="arm it first"):
        robot.requests.follow_gripper(opening_for(robot, 3, 0.01), GRIPPER, 1)
    robot.requests.arm(OURS + GRIPPER, 0)
    before = finger_target(simulation)
    with pytest.raises(CommandRefusedError, match="not the gripper's commander"):
        robot.requests.follow_gripper(opening_for(robot, 3, 0.01), OTHER, 1)
    for wrong in (-0.001, 0.026, float("nan")):
        with pytest.raises(CommandRefusedError, match="outside"):
            robot.requests.follow_gripper(opening_for(robot, 3, wrong), GRIPPER, 1)
    for sequence in range(1, 1000):
        robot.requests.follow_gripper(opening_for(robot, 3, 0.01), GRIPPER, sequence)
    assert len(robot.requests._openings) == MOST_WAITING
    robot.requests.disarm(OURS)
    robot.run(10)
    assert finger_target(simulation) == before
    robot.requests.arm(OURS + GRIPPER, 0)
    robot.run(10)
    assert finger_target(simulation) == before, "what waited for another commander is forgotten"
    # The next one between two cycles: the robot is never seen without a commander.
    robot.requests.follow_gripper(opening_for(robot, 3, 0.01), GRIPPER, 1)
    robot.requests.disarm(OURS)
    robot.requests.arm(OTHER + OURS, 0)
    robot.run(10)
    assert finger_target(simulation) == before, "what waited for another commander is forgotten"
    assert robot.refusals() == []


def test_gripper_obeys_the_commander_only(robot: LoneRobot) -> None:
    with pytest.raises(CommandRefusedError, match="arm it first"):
        robot.requests.open_gripper(0.01, GRIPPER)
    robot.requests.arm(OURS + GRIPPER, 0)
    with pytest.raises(CommandRefusedError, match="not the gripper's commander"):
        robot.requests.open_gripper(0.01, OTHER)
    for wrong in (-0.001, 0.026, float("nan")):
        with pytest.raises(CommandRefusedError, match="outside"):
            robot.requests.open_gripper(wrong, GRIPPER)
    robot.requests.open_gripper(0.02, GRIPPER)
    robot.run(300)
    assert robot.measured[7] == pytest.approx(0.02, abs=1e-3)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=200)
@given(data=st.binary(max_size=300))
def test_bytes_that_are_no_chunk_change_nothing(robot: LoneRobot, data: bytes) -> None:
    robot.requests.arm(OURS, 0)
    assert not robot.controller.receive(data, OURS, 1, 0)
    assert not robot.controller.receive(b"\x00\x01\x00\x00" + data, OURS, 2, 0)
    assert robot.controller.state is ServerState.HOLDING
    assert robot.controller.at_rest
