"""The robot server without its wires, on the real simulated robot: states, execution, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.backend import BackendFaultError
from skewmi.deploy.robot.backends.mujoco.backend import MujocoBackend
from skewmi.deploy.robot.controller import LEASE_NS, RobotController
from skewmi.deploy.robot.executor import PlanExecutor
from skewmi.deploy.robot.refusals import Refusal
from skewmi.deploy.robot.run import limit_check
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.safety.validation import (
    MAX_CHUNK_BYTES,
    ChunkValidator,
    ValidationRules,
)
from skewmi.deploy.wire.messages import JointStates, encode_chunk
from skewmi.errors import CommandRefusedError, NotFoundError
from skewmi.robot_models import limits as joint_limits
from skewmi.trajectory import GRID_NS, JointPoint, JointTrajectory, TrajectoryChunk

LAB = joint_limits.profile("lab")
OURS, OTHER, GRIPPER = b"a" * 16, b"b" * 16, b"g" * 16
TICK = GRID_NS


class WatchedBackend(MujocoBackend):
    """The simulated robot, and every target that it was given."""

    def __init__(self) -> None:
        self.targets: list[JointPoint] = []
        super().__init__()

    def step(self, target: JointPoint) -> None:
        self.targets.append(JointPoint(*(x.copy() for x in target)))
        super().step(target)


@pytest.fixture(scope="module")
def backend() -> WatchedBackend:
    return WatchedBackend()


@pytest.fixture
def robot(backend: WatchedBackend) -> RobotController:
    backend.reset_scene(seed=0)
    backend.targets.clear()
    assert backend.layout.workspace is not None
    rules = ValidationRules(joint_names=backend.joint_names, grid_ns=GRID_NS)
    validator = ChunkValidator(rules, limit_check(LAB, backend.layout.workspace))
    return RobotController(backend, validator)


def start_motion(robot: RobotController, size: float = 0.03) -> StartMotion:
    start = np.array(robot.commanded_position())
    return StartMotion(start, start + size * np.array([1, -0.5, 0, 0.5, 0, 1, 0]), LAB)


def motion_from(robot: RobotController, size: float = 0.03) -> JointTrajectory:
    return start_motion(robot, size).trajectory


def payload(robot: RobotController, motion: JointTrajectory, tick: int) -> bytes:
    names = robot._backend.joint_names
    return encode_chunk(TrajectoryChunk.of(tick * GRID_NS, names, motion))


def run(robot: RobotController, ticks: int, now_ns: int = 0) -> None:
    for _ in range(ticks):
        robot.step(now_ns)


def start_moving(robot: RobotController, size: float = 0.03) -> JointTrajectory:
    motion = motion_from(robot, size)
    robot.arm(OURS + GRIPPER, 0)
    assert robot.receive(payload(robot, motion, robot.tick_index + 3), OURS, 1, 0)
    return motion


def assert_within_limits(q: np.ndarray) -> None:
    """By differences of commanded positions on the grid: what a servo sees."""
    h = GRID_NS / 1e9
    for order, bound in ((1, LAB.velocity), (2, LAB.acceleration), (3, LAB.jerk)):
        peak = np.abs(np.diff(q, n=order, axis=0)).max(axis=0) / h**order
        assert (peak <= bound * (1 + 1e-6)).all(), (order, peak / bound)


def test_disarmed_robot_holds_still_and_refuses(robot: RobotController) -> None:
    motion = motion_from(robot)
    assert not robot.receive(payload(robot, motion, 5), OURS, 1, 0)
    (refusal,) = robot.take_refusals()
    assert "disarmed" in refusal.reason
    assert "arm it first" in refusal.reason
    assert not refusal.out_of_step
    assert refusal.stamp_ns == 5 * GRID_NS
    run(robot, 20)
    assert robot.state is ServerState.DISARMED
    assert np.ptp([t.q for t in robot._backend.targets], axis=0).max() == 0.0


def test_executes_chunks_exactly_on_the_grid(robot: RobotController) -> None:
    motion = start_moving(robot)
    run(robot, 3 + len(motion.q) + 10)
    targets = robot._backend.targets
    expected = np.concatenate(
        [np.tile(motion.q[0], (3, 1)), motion.q, np.tile(motion.q[-1], (10, 1))]
    )
    np.testing.assert_array_equal([t.q for t in targets], expected)
    np.testing.assert_array_equal([t.v for t in targets[3:-10]], motion.v)
    assert robot.state is ServerState.HOLDING
    measured = robot.measure().position[:7]
    assert np.abs(measured - motion.q[-1]).max() < 0.02


def test_keeps_executing_the_tail_if_nothing_newer_comes(robot: RobotController) -> None:
    whole = start_motion(robot, size=0.1)
    robot.arm(OURS, 0)
    for cycle in range(4):
        data = payload(robot, whole.chunk(cycle), 10 + 5 * cycle)
        assert robot.receive(data, OURS, cycle + 1, 0), robot.refusals
    assert np.abs(whole.chunk(3).v[5]).max() > 0.1, "the arm should be moving when all is quiet"
    run(robot, 120)
    q = np.array([t.q for t in robot._backend.targets])
    assert_within_limits(q)
    assert np.ptp(q[-20:], axis=0).max() == 0.0
    assert robot.state is ServerState.HOLDING


@pytest.mark.parametrize("when", range(6, 36, 6))
def test_stop_brakes_within_limits_and_disarms(robot: RobotController, when: int) -> None:
    motion = start_moving(robot)
    run(robot, when)
    robot.stop("test")
    assert robot.state is ServerState.STOPPING
    assert not robot.receive(payload(robot, motion, robot.tick_index + 3), OURS, 2, 0)
    with pytest.raises(CommandRefusedError, match="stopping"):
        robot.arm(OURS, 0)
    run(robot, 60)
    assert robot.state is ServerState.DISARMED
    q = np.array([t.q for t in robot._backend.targets])
    assert_within_limits(q)
    assert np.ptp(q[-10:], axis=0).max() == 0.0


def test_second_commander_is_refused_with_the_reason(robot: RobotController) -> None:
    start_moving(robot)
    motion = motion_from(robot)
    assert not robot.receive(payload(robot, motion, robot.tick_index + 50), OTHER, 1, 0)
    assert "is not the commander" in robot.take_refusals()[0].reason
    with pytest.raises(CommandRefusedError, match="holds the arm"):
        robot.arm(OTHER, 0)
    assert robot.state is ServerState.EXECUTING


def test_arming_without_gids_makes_the_first_valid_sender_the_commander(
    robot: RobotController,
) -> None:
    robot.arm(b"", 0)
    motion = motion_from(robot)
    assert robot.receive(payload(robot, motion, 3), OTHER, 9, 0)
    assert not robot.receive(payload(robot, motion, 60), OURS, 10, 0)


def test_silent_commander_loses_the_arm(robot: RobotController) -> None:
    start_moving(robot)
    run(robot, 60, now_ns=LEASE_NS)
    assert robot.state is ServerState.HOLDING
    run(robot, 1, now_ns=LEASE_NS + 1)
    assert robot.state is ServerState.DISARMED
    assert "no command for 2 s" in robot.machine.reason
    robot.arm(OTHER, LEASE_NS + 2)
    assert robot.state is ServerState.HOLDING


def test_older_chunk_does_not_overwrite_a_newer_one(robot: RobotController) -> None:
    robot.arm(OURS, 0)
    motion = motion_from(robot)
    assert robot.receive(payload(robot, motion, 20), OURS, 1, 0)
    assert not robot.receive(payload(robot, motion, 10), OURS, 2, 0)
    assert "not after the last accepted one" in robot.take_refusals()[0].reason


def test_joint_far_from_its_command_is_a_fault_until_acknowledged(
    robot: RobotController, backend: WatchedBackend
) -> None:
    robot.arm(OURS, 0)
    pushed = backend._data.qpos[backend.scene.arm_qpos] + 0.5
    backend._data.qpos[backend.scene.arm_qpos] = pushed
    run(robot, 1)
    assert robot.state is ServerState.FAULT
    assert "rad from its command" in robot.machine.reason
    with pytest.raises(CommandRefusedError, match="fault"):
        robot.arm(OURS, 0)
    robot.stop("test")
    assert robot.state is ServerState.DISARMED
    # It is held where it is now, not pulled back to where it was.
    assert np.abs(np.array(robot.commanded_position()) - pushed).max() < 0.05


def test_unphysical_simulation_is_a_fault(robot: RobotController, backend: WatchedBackend) -> None:
    backend._data.qvel[:] = np.nan
    with pytest.raises(BackendFaultError, match="mjWARN"):
        backend.step(robot.plan.point(0))
    backend._data.qvel[:] = np.nan
    run(robot, 1)
    assert robot.state is ServerState.FAULT


def test_fault_while_moving_still_follows_the_tail(
    robot: RobotController, monkeypatch: pytest.MonkeyPatch
) -> None:
    motion = start_moving(robot)
    run(robot, 9)
    step = robot._backend.step

    def broken(target: JointPoint) -> None:
        step(target)
        raise BackendFaultError("a fan stands still")

    monkeypatch.setattr(robot._backend, "step", broken)
    run(robot, 1)
    monkeypatch.undo()
    assert robot.state is ServerState.FAULT
    with pytest.raises(CommandRefusedError, match="yet to come to rest"):
        robot.stop("test")
    robot.disarm(OURS)
    assert robot.state is ServerState.FAULT, "a moving arm cannot be acknowledged"
    run(robot, len(motion.q) + 10)
    assert_within_limits(np.array([t.q for t in robot._backend.targets]))
    robot.disarm(OURS)
    assert robot.state is ServerState.FAULT, "nor by its commander"
    robot.stop("test")
    assert robot.state is ServerState.DISARMED


def test_an_arm_that_is_held_off_its_command_is_not_pulled_at(
    robot: RobotController, backend: WatchedBackend
) -> None:
    """Somebody stands in the way, and then steps aside."""
    q0 = np.array(robot.commanded_position())
    held = q0 + np.array([0.0, 0.0, 0.0, 0.4, 0.0, 0.0, 0.0])

    def hold() -> None:
        backend._data.qpos[backend.scene.arm_qpos] = held
        backend._data.qvel[backend.scene.arm_dof] = 0.0

    hold()
    run(robot, 1)
    assert robot.state is ServerState.FAULT
    assert "from its command" in robot.machine.reason
    speeds = []
    for tick in range(150):
        if tick < 50:
            hold()
        run(robot, 1)
        speeds.append(np.abs(backend._data.qvel[backend.scene.arm_dof]).max())
        assert np.abs(backend.targets[-1].q - held).max() < 0.02
    assert max(speeds) < 0.2, "the arm snaps"
    assert np.abs(np.array(robot.commanded_position()) - held).max() < 0.02


def test_a_measurement_that_is_no_number_is_a_fault(
    robot: RobotController, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = robot._backend.arm_position()
    measured[2] = np.nan
    monkeypatch.setattr(robot._backend, "arm_position", lambda: measured)
    before = robot.commanded_position()
    run(robot, 1)
    assert robot.state is ServerState.FAULT
    assert robot.commanded_position() == before


@pytest.mark.parametrize("how", ["stop", "disarm", "lost"])
def test_a_motion_that_has_not_begun_never_begins(robot: RobotController, how: str) -> None:
    """A chunk may be due half a second from now."""
    robot.arm(OURS, 0)
    motion = motion_from(robot)
    assert robot.receive(payload(robot, motion, robot.tick_index + 100), OURS, 1, 0)
    run(robot, 90)
    if how == "stop":
        robot.stop("test")
    elif how == "disarm":
        robot.disarm(OURS)
    else:
        run(robot, 1, LEASE_NS + 1)
    assert robot.state is ServerState.DISARMED
    run(robot, 120)
    assert np.ptp([t.q for t in robot._backend.targets], axis=0).max() == 0.0


def test_silence_is_noticed_before_what_comes_after_it(robot: RobotController) -> None:
    """The robot server itself may have been frozen: what was sent meanwhile waits for it."""
    motion = motion_from(robot)
    robot.arm(OURS, 0)
    late = LEASE_NS + 1
    assert not robot.receive(payload(robot, motion, robot.tick_index + 3), OURS, 1, late)
    assert robot.state is ServerState.DISARMED
    start_moving(robot)
    run(robot, 10)
    with pytest.raises(CommandRefusedError, match="stopping"):
        robot.arm(OTHER, late)
    assert robot.state is ServerState.STOPPING


def test_arming_again_shows_that_one_is_there(robot: RobotController) -> None:
    robot.arm(OURS + GRIPPER, 0)
    robot.arm(OURS + OTHER, LEASE_NS)
    run(robot, 1, 2 * LEASE_NS)
    assert robot.state is ServerState.HOLDING
    robot.open_gripper(0.01, OTHER)
    run(robot, 1, 2 * LEASE_NS + 1)
    assert robot.state is ServerState.DISARMED


def test_strangers_cost_little(robot: RobotController, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of their messages is decoded, and nothing long of anybody's."""
    start_moving(robot)
    decoded = []
    monkeypatch.setattr(
        "skewmi.deploy.robot.controller.decode_chunk", lambda data: decoded.append(data)
    )
    assert not robot.receive(b"anything", OTHER, 2, 0)
    assert not robot.receive(bytes(MAX_CHUNK_BYTES + 1), OURS, 2, 0)
    assert decoded == []
    stranger, ours = robot.take_refusals()
    assert "not the commander" in stranger.reason
    assert "at most" in ours.reason
    monkeypatch.undo()
    for sequence in range(100):
        robot.receive(b"x", OTHER, sequence, 0)
        robot.receive(b"x", OURS, sequence, 0)
    assert robot.refused == 202
    kept = robot.take_refusals()
    assert sum(refusal.of_commander for refusal in kept) == 100
    assert len(kept) <= 132


@pytest.mark.parametrize("text", ["\x1b[2J[/bold] over\n\u202eand out", "a" * 100_000])
def test_what_strangers_say_is_told_in_one_short_line(robot: RobotController, text: str) -> None:
    start_moving(robot)
    run(robot, 10)
    robot.stop(text)
    robot.note_refusal(Refusal(text))
    for told in (robot.machine.reason, robot.take_refusals()[0].reason):
        assert len(told) < 400
        assert told.isprintable()
        assert text[5:20].isprintable() is False or text[5:20] in told


def test_the_longest_chunk_is_not_too_long(robot: RobotController) -> None:
    longest = JointTrajectory.resting(np.zeros(7), ValidationRules.max_points)
    assert len(payload(robot, longest, 0)) < MAX_CHUNK_BYTES


def test_gripper_commands_name_their_joint(robot: RobotController) -> None:
    robot.arm(OURS, 0)
    finger, nothing = robot._backend.measure().names[7], np.zeros(0)
    for names in ((), ("yumi_joint_1_r",), (finger, "yumi_joint_1_r")):
        command = JointStates(robot.clock_ns, names, np.full(len(names), 0.02), nothing, nothing)
        with pytest.raises(CommandRefusedError, match=f"that of {finger}, is expected"):
            robot.follow_gripper(command, GRIPPER, 1)
    with pytest.raises(CommandRefusedError, match="outside"):
        robot.open_gripper(1.0, OTHER)
    assert robot.lease.gripper_holder is None, "who said nonsense is no commander"
    command = JointStates(robot.clock_ns, (finger,), np.array([0.02]), nothing, nothing)
    robot.follow_gripper(command, GRIPPER, 1)
    assert robot.lease.gripper_holder == GRIPPER


def test_a_scene_that_somebody_works_in_is_not_reset(robot: RobotController) -> None:
    robot.arm(OURS, 0)
    robot.reset_scene(1)
    motion = motion_from(robot)
    assert robot.receive(payload(robot, motion, robot.tick_index + 3), OURS, 1, 0)
    run(robot, len(motion.q) + 10)
    assert robot.state is ServerState.HOLDING
    with pytest.raises(CommandRefusedError, match="works in the scene"):
        robot.reset_scene(1)
    robot.disarm(OURS)
    robot.reset_scene(1)


def test_a_physics_fault_that_was_acknowledged_is_over(
    robot: RobotController, backend: WatchedBackend
) -> None:
    backend._data.qvel[backend.scene.arm_dof] = 1e11
    run(robot, 1)
    assert robot.state is ServerState.FAULT
    assert "the simulation raised" in robot.machine.reason
    backend._data.qvel[:] = 0.0
    run(robot, 50)
    robot.stop("test")
    run(robot, 5)
    assert robot.state is ServerState.DISARMED


def test_scene_resets_at_rest_only(robot: RobotController, backend: WatchedBackend) -> None:
    start_moving(robot)
    run(robot, 10)
    with pytest.raises(CommandRefusedError, match="moving"):
        robot.reset_scene(1)
    run(robot, 60)
    robot.disarm(OURS)
    backend._data.qpos[backend.scene.scene_qpos[0]] = 1.0
    robot.reset_scene(1)
    measured = robot.measure()
    assert measured.scene_position[0] == 0.0
    assert robot.commanded_position() == pytest.approx(measured.position[:7], abs=1e-12)


def test_gripper_obeys_the_commander_only(robot: RobotController) -> None:
    with pytest.raises(CommandRefusedError, match="arm it first"):
        robot.open_gripper(0.01, GRIPPER)
    robot.arm(OURS + GRIPPER, 0)
    with pytest.raises(CommandRefusedError, match="not the gripper's commander"):
        robot.open_gripper(0.01, OTHER)
    for wrong in (-0.001, 0.026, float("nan")):
        with pytest.raises(CommandRefusedError, match="outside"):
            robot.open_gripper(wrong, GRIPPER)
    robot.open_gripper(0.02, GRIPPER)
    run(robot, 300)
    assert robot.measure().position[7] == pytest.approx(0.02, abs=1e-3)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=200)
@given(data=st.binary(max_size=300))
def test_bytes_that_are_no_chunk_change_nothing(robot: RobotController, data: bytes) -> None:
    robot.arm(OURS, 0)
    assert not robot.receive(data, OURS, 1, 0)
    assert not robot.receive(b"\x00\x01\x00\x00" + data, OURS, 2, 0)
    assert robot.state is ServerState.HOLDING
    assert robot.plan.at_rest(robot.tick_index)


@given(ends=st.lists(st.tuples(st.integers(0, 20), st.integers(2, 30)), max_size=8))
def test_plan_is_the_newest_chunk_at_every_tick(ends: list[tuple[int, int]]) -> None:
    plan, now = PlanExecutor(np.zeros(1), 0), 0
    expected: dict[int, float] = {}
    last = 0.0
    for number, (ahead, length) in enumerate(ends, start=1):
        now += 3
        tick = now + ahead
        q = np.full((length, 1), float(number))
        plan.splice(tick, JointTrajectory(q, q, q), now)
        for t in range(now, now + 100):
            if t >= tick:
                expected[t] = float(number)
        last = float(number)
    for t in range(now, now + 60):
        assert plan.point(t).q[0] == expected.get(t, 0.0 if not ends else expected.get(t, 0.0))
    assert plan.point(plan.last_tick + 1000).q[0] == last
    assert plan.at_rest(plan.last_tick)
    assert not plan.at_rest(plan.last_tick - 1)


def test_unknown_task_is_named_with_those_that_exist() -> None:
    with pytest.raises(NotFoundError, match="open_press_close"):
        MujocoBackend("point_maze")
