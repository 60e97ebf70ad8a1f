"""The robot server without its wires, on the real simulated robot: states, execution, faults."""

from __future__ import annotations

import numpy as np
import pytest
from lone_motions import (
    OURS,
    assert_within_limits,
    motion_from,
    start_motion,
    start_moving,
)
from lone_robot import LoneRobot

from skewmi.deploy.robot.backend import BackendFaultError, RobotState
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.robot.controller import LEASE_NS
from skewmi.deploy.robot.states import ServerState
from skewmi.errors import CommandRefusedError
from skewmi.trajectory import GRID_NS, JointPoint


def test_disarmed_robot_holds_still_and_refuses(robot: LoneRobot) -> None:
    motion = motion_from(robot)
    assert not robot.controller.receive(robot.payload(motion, 5), OURS, 1, 0)
    (refusal,) = robot.refusals()
    assert "disarmed" in refusal.reason
    assert "arm it first" in refusal.reason
    assert not refusal.out_of_step
    assert refusal.stamp_ns == 5 * GRID_NS
    robot.run(20)
    assert robot.controller.state is ServerState.DISARMED
    assert np.ptp([t.q for t in robot.targets], axis=0).max() == 0.0


def test_executes_chunks_exactly_on_the_grid(robot: LoneRobot) -> None:
    motion = start_moving(robot)
    robot.run(3 + len(motion.q) + 10)
    targets = robot.targets
    expected = np.concatenate(
        [np.tile(motion.q[0], (3, 1)), motion.q, np.tile(motion.q[-1], (10, 1))]
    )
    np.testing.assert_array_equal([t.q for t in targets], expected)
    np.testing.assert_array_equal([t.v for t in targets[3:-10]], motion.v)
    assert robot.controller.state is ServerState.HOLDING
    measured = robot.measured[:7]
    assert np.abs(measured - motion.q[-1]).max() < 0.02


def test_keeps_executing_the_tail_if_nothing_newer_comes(robot: LoneRobot) -> None:
    whole = start_motion(robot, size=0.1)
    robot.requests.arm(OURS, 0)
    for cycle in range(4):
        data = robot.payload(whole.chunk(cycle), 10 + 5 * cycle)
        assert robot.controller.receive(data, OURS, cycle + 1, 0), robot.refusals
    assert np.abs(whole.chunk(3).v[5]).max() > 0.1, "the arm should be moving when all is quiet"
    robot.run(120)
    q = np.array([t.q for t in robot.targets])
    assert_within_limits(q)
    assert np.ptp(q[-20:], axis=0).max() == 0.0
    assert robot.controller.state is ServerState.HOLDING


@pytest.mark.parametrize("when", range(6, 36, 6))
def test_stop_brakes_within_limits_and_disarms(robot: LoneRobot, when: int) -> None:
    motion = start_moving(robot)
    robot.run(when)
    robot.requests.stop("test")
    assert robot.controller.state is ServerState.STOPPING
    assert not robot.controller.receive(robot.payload(motion, robot.due + 3), OURS, 2, 0)
    with pytest.raises(CommandRefusedError, match="stopping"):
        robot.requests.arm(OURS, 0)
    robot.run(60)
    assert robot.controller.state is ServerState.DISARMED
    q = np.array([t.q for t in robot.targets])
    assert_within_limits(q)
    assert np.ptp(q[-10:], axis=0).max() == 0.0


def test_older_chunk_does_not_overwrite_a_newer_one(robot: LoneRobot) -> None:
    robot.requests.arm(OURS, 0)
    motion = motion_from(robot)
    assert robot.controller.receive(robot.payload(motion, 20), OURS, 1, 0)
    assert not robot.controller.receive(robot.payload(motion, 10), OURS, 2, 0)
    assert "not after the last accepted one" in robot.refusals()[0].reason


def test_joint_far_from_its_command_is_a_fault_until_acknowledged(
    robot: LoneRobot, simulation: ArmSimulation
) -> None:
    robot.requests.arm(OURS, 0)
    pushed = simulation._data.qpos[simulation.scene.arm_qpos] + 0.5
    simulation._data.qpos[simulation.scene.arm_qpos] = pushed
    robot.run(1)
    assert robot.controller.state is ServerState.FAULT
    assert "rad from its command" in robot.controller.machine.reason
    with pytest.raises(CommandRefusedError, match="fault"):
        robot.requests.arm(OURS, 0)
    robot.requests.stop("test")
    assert robot.controller.state is ServerState.DISARMED
    # It is held where it is now, not pulled back to where it was.
    assert np.abs(robot.commanded - pushed).max() < 0.05


def test_unphysical_simulation_is_a_fault(robot: LoneRobot, simulation: ArmSimulation) -> None:
    simulation._data.qvel[:] = np.nan
    with pytest.raises(BackendFaultError, match="mjWARN"):
        simulation.step()
    simulation._data.qvel[:] = np.nan
    robot.run(1)
    assert robot.controller.state is ServerState.FAULT


def test_fault_while_moving_still_follows_the_tail(
    robot: LoneRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    motion = start_moving(robot)
    robot.run(9)
    write = robot.backend.write

    def broken(command: JointPoint) -> None:
        write(command)
        raise BackendFaultError("a fan stands still")

    monkeypatch.setattr(robot.backend, "write", broken)
    robot.run(1)
    monkeypatch.undo()
    assert robot.controller.state is ServerState.FAULT
    with pytest.raises(CommandRefusedError, match="yet to come to rest"):
        robot.requests.stop("test")
    robot.requests.disarm(OURS)
    assert robot.controller.state is ServerState.FAULT, "a moving arm cannot be acknowledged"
    robot.run(len(motion.q) + 10)
    assert_within_limits(np.array([t.q for t in robot.targets]))
    robot.requests.disarm(OURS)
    assert robot.controller.state is ServerState.FAULT, "nor by its commander"
    robot.requests.stop("test")
    assert robot.controller.state is ServerState.DISARMED


@pytest.mark.parametrize("then", ["nothing", "stop", "brake"])
def test_a_fault_drops_what_has_not_begun(
    robot: LoneRobot, monkeypatch: pytest.MonkeyPatch, then: str
) -> None:
    """A resting arm stays at rest, whatever was accepted for later, and whoever asks for what."""
    robot.requests.arm(OURS, 0)
    assert robot.controller.receive(robot.payload(motion_from(robot), 100), OURS, 1, 0)
    monkeypatch.setattr(robot.backend, "readiness", lambda: "the other arm is not at home")
    robot.run(1)
    assert robot.controller.state is ServerState.FAULT
    if then == "stop":
        robot.requests.stop("test")
        assert robot.controller.state is ServerState.DISARMED
    if then == "brake":
        robot.requests.brake("test")
    robot.run(300)
    assert np.ptp([t.q for t in robot.targets], axis=0).max() == 0.0
    assert robot.controller.at_rest


@pytest.mark.parametrize("moving", [True, False])
def test_a_position_that_is_not_finite_is_a_fault_and_never_commanded(
    robot: LoneRobot, monkeypatch: pytest.MonkeyPatch, moving: bool
) -> None:
    if moving:
        start_moving(robot)
        robot.run(9)
    read = robot.backend.read

    def unread() -> RobotState | None:
        state = read()
        if state is not None:
            state.position[2] = np.nan
        return state

    monkeypatch.setattr(robot.backend, "read", unread)
    robot.run(80)
    assert robot.controller.state is ServerState.FAULT
    assert "not finite" in robot.controller.machine.reason
    robot.requests.stop("test")
    robot.run(5)
    assert robot.controller.state is ServerState.FAULT, "it still does not tell where it is"
    monkeypatch.undo()
    robot.requests.stop("test")
    robot.run(5)
    assert robot.controller.state is ServerState.DISARMED
    targets = np.array([t.q for t in robot.targets])
    assert np.isfinite(targets).all()
    if not moving:
        assert np.ptp(targets, axis=0).max() < 0.01


def test_an_arm_that_is_held_off_its_command_is_not_pulled_at(
    robot: LoneRobot, simulation: ArmSimulation
) -> None:
    """Somebody stands in the way, and then steps aside."""
    q0 = robot.commanded
    held = q0 + np.array([0.0, 0.0, 0.0, 0.4, 0.0, 0.0, 0.0])

    def hold() -> None:
        simulation._data.qpos[simulation.scene.arm_qpos] = held
        simulation._data.qvel[simulation.scene.arm_dof] = 0.0

    hold()
    robot.run(1)
    assert robot.controller.state is ServerState.FAULT
    assert "from its command" in robot.controller.machine.reason
    speeds = []
    for tick in range(150):
        if tick < 50:
            hold()
        robot.run(1)
        speeds.append(np.abs(simulation._data.qvel[simulation.scene.arm_dof]).max())
        assert np.abs(robot.targets[-1].q - held).max() < 0.02
    assert max(speeds) < 0.2, "the arm snaps"
    assert np.abs(robot.commanded - held).max() < 0.02


def test_a_measurement_that_is_no_number_is_a_fault(
    robot: LoneRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = robot.backend.read

    def broken() -> RobotState | None:
        state = read()
        assert state is not None
        state.position[2] = np.nan
        return state

    monkeypatch.setattr(robot.backend, "read", broken)
    before = robot.controller.arm_motion.commanded_position()
    robot.run(1)
    assert robot.controller.state is ServerState.FAULT
    assert robot.controller.arm_motion.commanded_position() == before


@pytest.mark.parametrize("how", ["stop", "disarm", "lost"])
def test_a_motion_that_has_not_begun_never_begins(robot: LoneRobot, how: str) -> None:
    """A chunk may be due half a second from now."""
    robot.requests.arm(OURS, 0)
    motion = motion_from(robot)
    assert robot.controller.receive(robot.payload(motion, robot.due + 100), OURS, 1, 0)
    robot.run(90)
    if how == "stop":
        robot.requests.stop("test")
    elif how == "disarm":
        robot.requests.disarm(OURS)
    else:
        robot.run(1, LEASE_NS + 1)
    assert robot.controller.state is ServerState.DISARMED
    robot.run(120)
    assert np.ptp([t.q for t in robot.targets], axis=0).max() == 0.0


def test_rest_is_told_once_the_last_sample_has_been_commanded(robot: LoneRobot) -> None:
    """A robot that is left alone then stays where the plan ends, not one sample before."""
    motion = start_moving(robot)
    robot.run(10)
    robot.requests.stop("test")
    while robot.controller.state is ServerState.STOPPING:
        robot.run(1)
    np.testing.assert_array_equal(robot.targets[-1].q, motion.q[-1])
    assert len(robot.targets) == 3 + len(motion)


def test_a_motion_that_was_dropped_delays_no_other(robot: LoneRobot) -> None:
    robot.requests.arm(OURS, 0)
    motion = motion_from(robot)
    assert robot.controller.receive(robot.payload(motion, robot.due + 100), OURS, 1, 0)
    robot.run(5)
    robot.requests.stop("test")
    robot.requests.arm(OURS, 0)
    assert not robot.controller.may_advance(), "in lock-step, time waits for a command"
    assert robot.controller.receive(robot.payload(motion, robot.due), OURS, 2, 0)


def test_a_physics_fault_that_was_acknowledged_is_over(
    robot: LoneRobot, simulation: ArmSimulation
) -> None:
    simulation._data.qvel[simulation.scene.arm_dof] = 1e11
    robot.run(1)
    assert robot.controller.state is ServerState.FAULT
    assert "the simulation raised" in robot.controller.machine.reason
    simulation._data.qvel[:] = 0.0
    robot.run(50)
    robot.requests.stop("test")
    robot.run(5)
    assert robot.controller.state is ServerState.DISARMED
