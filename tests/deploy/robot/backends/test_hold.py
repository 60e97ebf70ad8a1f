"""The robot that holds its command, and what it proves: any cycle, no scene, a robot not ready."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lone_robot import LoneRobot

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot import run as robot_run
from skewmi.deploy.robot.backend import BackendFaultError, RobotState
from skewmi.deploy.robot.backends import BACKENDS, BackendOptions, make_backend
from skewmi.deploy.robot.backends.hold import HoldBackend
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import encode_chunk
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import CommandRefusedError, ConfigurationError, NotFoundError
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi
from skewmi.trajectory import CYCLE_NS, GRID_NS, TrajectoryChunk

LAB = joint_limits.profile("lab")
HOME = np.array(yumi.HOME["right"])
AWAY = HOME + np.linspace(0.3, -0.3, 7)
OURS = b"a" * 16


def holding(period_ns: int = GRID_NS, delay_s: float = 0.0) -> HoldBackend:
    return HoldBackend(HOME, delay_s=delay_s, lock_step=True, period_ns=period_ns)


# The clock is the robot's.


@pytest.mark.parametrize("period_ns", [4_000_000, 4_032_000, 3_968_000, 8_064_000])
def test_a_plan_is_followed_in_true_time_whatever_the_cycle(period_ns: int) -> None:
    """Streamed as a session does: the robot gets the motion itself, at its own times."""
    robot = LoneRobot(holding(period_ns), LAB)
    motion = StartMotion(HOME, AWAY, LAB)
    robot.requests.arm(OURS, 0)
    begin_ns = 5 * CYCLE_NS
    times_ns, sent = [], 0
    while robot.controller.clock_ns < begin_ns + round(1e9 * motion.trajectory.duration_s):
        # Some 24 ms before each chunk is due, as the states of the newest cycle arrive.
        if sent < motion.cycles and robot.controller.clock_ns >= begin_ns + (sent - 1) * CYCLE_NS:
            tick = (begin_ns + sent * CYCLE_NS) // GRID_NS
            payload = robot.payload(motion.chunk(sent), tick)
            assert robot.controller.receive(payload, OURS, sent + 1, 0), robot.refusals()
            sent += 1
        robot.run(1)
        times_ns.append(robot.controller.arm_motion.executed_ns)
    assert sent == motion.cycles
    targets = robot.targets
    assert len(targets) == len(times_ns)
    for time_ns, target in zip(times_ns, targets, strict=True):
        expected = motion.trajectory.at(time_ns - begin_ns)
        for part, wanted in zip(target, expected, strict=True):
            np.testing.assert_allclose(part, wanted, atol=1e-9)
    # By differences of positions over the robot's own cycle, in true time. Where jerk switches
    # between two samples, parts in ten thousand are allowed for.
    q, h = np.array([target.q for target in targets]), period_ns / 1e9
    for order, bound in ((1, LAB.velocity), (2, LAB.acceleration), (3, LAB.jerk)):
        peak = np.abs(np.diff(q, n=order, axis=0)).max(axis=0) / h**order
        assert (peak <= bound * (1 + 1e-3)).all(), (order, peak / bound)


def test_cycles_that_were_lost_are_left_out() -> None:
    """The plan goes on in the robot's time; it is not late for ever after."""
    robot = LoneRobot(holding(), LAB)
    motion = StartMotion(HOME, HOME + 0.05, LAB).trajectory
    robot.requests.arm(OURS, 0)
    stamp = robot.due + 3
    assert robot.controller.receive(robot.payload(motion, stamp), OURS, 1, 0)
    robot.run(10)
    robot.backend._time_ns += 2 * GRID_NS  # type: ignore[attr-defined]
    robot.run(1)
    due = robot.controller.arm_motion.executed_ns - stamp * GRID_NS
    np.testing.assert_array_equal(robot.targets[-1].q, motion.at(due).q)


@given(delay=st.integers(0, 20), ticks=st.integers(1, 40))
@settings(deadline=None)
def test_a_command_shows_after_its_delay(delay: int, ticks: int) -> None:
    backend = holding(delay_s=delay * GRID_NS / 1e9)
    robot = LoneRobot(backend, LAB)
    robot.requests.arm(OURS, 0)
    motion = StartMotion(HOME, HOME + 0.05, LAB).trajectory
    assert robot.controller.receive(robot.payload(motion, robot.due), OURS, 1, 0)
    robot.run(ticks)
    # In the cycle after a command at the earliest.
    shown = ticks - 1 - max(delay, 1)
    expected = HOME if shown < 0 else motion.point(shown).q
    np.testing.assert_array_equal(robot.measured[:7], expected)


# A robot may lack a scene, or not be ready.


def test_without_a_scene_there_is_nothing_to_reset() -> None:
    robot = LoneRobot(holding(), LAB)
    with pytest.raises(CommandRefusedError, match="'hold' has no scene"):
        robot.requests.reset_scene(0)


class Unready(HoldBackend):
    """Lacks something, as long as it is told to."""

    missing: str | None = None
    states = True

    def readiness(self) -> str | None:
        return self.missing

    def read(self) -> RobotState | None:
        state = super().read()
        return state if self.states else None


@pytest.fixture
def unready() -> Unready:
    return Unready(HOME, lock_step=True)


def test_arming_is_refused_for_the_reason_that_the_robot_gives(unready: Unready) -> None:
    robot = LoneRobot(unready, LAB)
    unready.missing = "the motors are off"
    with pytest.raises(CommandRefusedError, match="not ready: the motors are off"):
        robot.requests.arm(OURS, 0)
    assert robot.controller.lease.holder is None
    unready.missing = None
    robot.requests.arm(OURS, 0)
    assert robot.controller.state is ServerState.HOLDING


def test_a_robot_that_is_no_longer_ready_is_a_fault_once_it_is_armed(unready: Unready) -> None:
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
    assert robot.controller.state is ServerState.FAULT
    assert robot.controller.machine.reason == "the motors are off"


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
    robot = LoneRobot(holding(), LAB)
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


# By name, and over the wire.


def test_every_robot_of_the_registry_can_be_made() -> None:
    for name in BACKENDS:
        assert make_backend(name, BackendOptions()).name == name
    with pytest.raises(NotFoundError, match=", ".join(BACKENDS)):
        make_backend("r2d2", BackendOptions())


def test_options_of_other_robots_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="nothing that varies"):
        make_backend("hold", BackendOptions(variation="randomised"))
    with pytest.raises(ConfigurationError, match="--variation instead"):
        make_backend("sim", BackendOptions(delay_s=0.01))
    for delay_s in (-1.0, float("nan"), 11.0):
        with pytest.raises(ConfigurationError, match="delay"):
            make_backend("hold", BackendOptions(delay_s=delay_s))


@contextmanager
def served(backend: HoldBackend, monkeypatch: pytest.MonkeyPatch) -> Iterator[Link]:
    """A server of a robot in a thread, and a link to it."""
    monkeypatch.setattr(robot_run, "make_backend", lambda name, options: backend)
    locator = f"tcp/127.0.0.1:{free_port()}"
    stop, ready = threading.Event(), threading.Event()
    config = TransportConfig.for_robot(locator)
    arguments = ("hold", BackendOptions(), config, LAB, stop, lambda _: ready.set())
    thread = threading.Thread(target=robot_run.serve_robot, args=arguments)
    thread.start()
    try:
        assert ready.wait(20.0)
        with Link.open(TransportConfig.for_client(locator), "test") as link:
            link.wait_for_robot(5.0)
            yield link
    finally:
        stop.set()
        thread.join(20.0)
        assert not thread.is_alive()


def describe(link: Link) -> RobotDescription:
    return RobotDescription.from_json(link.call(topics.YUMI_DESCRIBE, 5.0).message)


def test_a_served_robot_without_a_scene_moves_and_tells_no_scene(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with served(HoldBackend(HOME, period_ns=4_032_000), monkeypatch) as link:
        described = describe(link)
        assert (described.backend, described.task, described.layout_hashes) == ("hold", "", ())
        assert not described.simulated
        assert not described.lock_step
        publisher = link.publisher(topics.YUMI_TRAJECTORY)
        states = link.subscribe(topics.YUMI_JOINT_STATES)
        scene = link.subscribe(topics.YUMI_SCENE_STATES)
        assert link.call(topics.YUMI_ARM, 5.0, publisher.gid).success
        motion = StartMotion(HOME, HOME + 0.02, LAB).trajectory
        soon_ns = described.clock_ns - described.clock_ns % GRID_NS + 400_000_000
        chunk = TrajectoryChunk.of(soon_ns, described.joint_names, motion)
        publisher.put(encode_chunk(chunk))
        for _ in range(500):
            states.wait(5.0)
            now = describe(link)
            if now.state == "holding" and now.commanded_position == tuple(HOME + 0.02):
                break
        assert now.commanded_position == tuple(HOME + 0.02), now
        assert scene.latest() is None


def test_before_its_first_cycle_a_robot_is_described_as_not_ready(
    unready: Unready, monkeypatch: pytest.MonkeyPatch
) -> None:
    unready.states, unready.missing = False, "no packet from the controller yet"
    unready.lock_step = False
    with served(unready, monkeypatch) as link:
        described = describe(link)
        assert described.state == "disarmed"
        assert described.commanded_position == ()
        assert "not ready: no packet" in described.reason
        armed = link.call(topics.YUMI_ARM, 5.0, OURS)
        assert not armed.success
        assert "no packet from the controller yet" in armed.message
        unready.states, unready.missing = True, None
        assert link.call(topics.YUMI_ARM, 5.0, OURS).success
        assert describe(link).commanded_position == tuple(HOME)


def test_a_robot_that_cannot_be_read_is_a_fault_and_still_served(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Broken(HoldBackend):
        broken = False

        def read(self) -> RobotState | None:
            state = super().read()
            if self.broken:
                raise BackendFaultError("no packet from the controller for 0.1 s")
            return state

    backend = Broken(HOME)
    with served(backend, monkeypatch) as link:
        assert link.call(topics.YUMI_ARM, 5.0, OURS).success
        backend.broken = True
        link.call(topics.YUMI_DESCRIBE, 5.0)
        described = describe(link)
        assert (described.state, described.reason) == (
            "fault",
            "no packet from the controller for 0.1 s",
        )
        backend.broken = False
        assert link.call(topics.YUMI_STOP, 5.0).message == "disarmed"
