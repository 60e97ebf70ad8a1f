"""The robot server without its wires, on the real simulated robot: states, execution, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lone_robot import LoneRobot

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.backend import BackendFaultError, RobotState
from skewmi.deploy.robot.backends.mujoco.backend import MujocoBackend
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.robot.controller import LEASE_NS
from skewmi.deploy.robot.executor import PlanExecutor
from skewmi.deploy.robot.refusals import Refusal
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.safety.validation import MAX_CHUNK_BYTES, ValidationRules
from skewmi.deploy.wire.messages import JointStates
from skewmi.errors import CommandRefusedError, NotFoundError
from skewmi.robot_models import limits as joint_limits
from skewmi.trajectory import GRID_NS, JointPoint, JointTrajectory

LAB = joint_limits.profile("lab")
OURS, OTHER, GRIPPER = b"a" * 16, b"b" * 16, b"g" * 16


@pytest.fixture(scope="module")
def simulation() -> ArmSimulation:
    return ArmSimulation()


@pytest.fixture
def robot(simulation: ArmSimulation) -> LoneRobot:
    simulation.reset(seed=0)
    return LoneRobot(MujocoBackend(simulation, lock_step=True), LAB)


def start_motion(robot: LoneRobot, size: float = 0.03) -> StartMotion:
    start = robot.commanded
    return StartMotion(start, start + size * np.array([1, -0.5, 0, 0.5, 0, 1, 0]), LAB)


def motion_from(robot: LoneRobot, size: float = 0.03) -> JointTrajectory:
    return start_motion(robot, size).trajectory


def start_moving(robot: LoneRobot, size: float = 0.03) -> JointTrajectory:
    motion = motion_from(robot, size)
    robot.requests.arm(OURS + GRIPPER, 0)
    assert robot.controller.receive(robot.payload(motion, robot.due + 3), OURS, 1, 0)
    return motion


def assert_within_limits(q: np.ndarray) -> None:
    """By differences of commanded positions on the grid: what a servo sees."""
    h = GRID_NS / 1e9
    for order, bound in ((1, LAB.velocity), (2, LAB.acceleration), (3, LAB.jerk)):
        peak = np.abs(np.diff(q, n=order, axis=0)).max(axis=0) / h**order
        assert (peak <= bound * (1 + 1e-6)).all(), (order, peak / bound)


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


@given(ends=st.lists(st.tuples(st.integers(0, 20), st.integers(2, 30)), max_size=8))
def test_plan_is_the_newest_chunk_at_every_tick(ends: list[tuple[int, int]]) -> None:
    plan, now = PlanExecutor(np.zeros(1), 0), 0
    expected: dict[int, float] = {}
    last = 0.0
    for number, (ahead, length) in enumerate(ends, start=1):
        now += 3
        tick = now + ahead
        q = np.full((length, 1), float(number))
        plan.splice(tick * GRID_NS, JointTrajectory(q, q, q), now * GRID_NS)
        for t in range(now, now + 100):
            if t >= tick:
                expected[t] = float(number)
        last = float(number)
    for t in range(now, now + 60):
        at_tick = plan.at(t * GRID_NS).q[0]
        assert at_tick == expected.get(t, 0.0 if not ends else expected.get(t, 0.0))
    assert plan.at(plan.end_ns + 1000 * GRID_NS).q[0] == last
    assert plan.at_rest(plan.end_ns)
    assert not plan.at_rest(plan.end_ns - 1)


def test_unknown_task_is_named_with_those_that_exist() -> None:
    with pytest.raises(NotFoundError, match="open_press_close"):
        ArmSimulation("point_maze")
