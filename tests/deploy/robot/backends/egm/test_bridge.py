"""The bridge on the robot server's seam, against a controller written by hand.

Everything but the wires to the session: packets come in, chunks are accepted, references go out.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from math import radians

import numpy as np
import pytest
from egm_controller import HandController
from egm_wire import MCI_ERROR, MCI_STOPPED, MOTORS_OFF, RAPID_STOPPED, RAPID_UNDEFINED, Reference

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.backends import BackendOptions, make_backend
from skewmi.deploy.robot.backends.egm.backend import EgmBackend
from skewmi.deploy.robot.backends.egm.options import EgmOptions
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.controller import RobotController
from skewmi.deploy.robot.gripper.fixed import FixedGripper
from skewmi.deploy.robot.requests import RobotRequests
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.safety.checks import limit_check
from skewmi.deploy.safety.validation import ChunkValidator, ValidationRules
from skewmi.deploy.wire.messages import encode_chunk
from skewmi.errors import CommandRefusedError, ConfigurationError, TransportError
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi
from skewmi.trajectory import GRID_NS, TrajectoryChunk

LAB = joint_limits.profile("lab")
OURS = b"a" * 16
CHAIN = np.array([0.0, -130.0, -135.0, 30.0, 0.0, 40.0, 0.0])
RAMP_CYCLES = 30


class Bench:
    """A bridge and its controller, cycle by cycle; time goes on with the controller's packets."""

    def __init__(self, options: EgmOptions | None = None) -> None:
        self.options = options or EgmOptions(listen="127.0.0.1:0", listen_left="none")
        self.backend = EgmBackend(self.options, FixedGripper(0.014))
        rules = ValidationRules(joint_names=self.backend.joint_names, grid_ns=GRID_NS)
        speed = self.backend.admitted_speed
        validator = ChunkValidator(rules, limit_check(LAB, None, speed))
        self.robot = RobotController(self.backend, validator)
        self.requests = RobotRequests(self.backend, self.robot)
        self.backend.open(lambda: True)
        assert self.backend.right is not None
        self.link = self.backend.right.link
        self.now_ns = 1_000_000_000
        self.link.now_ns = lambda: self.now_ns
        self.controller = HandController(self.link.address)
        self.sequence = 0

    def close(self) -> None:
        self.controller.socket.close()
        self.backend.close()

    def pass_time(self, seconds: float) -> None:
        self.now_ns += int(1e9 * seconds)

    def cycle(self, **changes: object) -> list[Reference]:
        """The controller sends a packet; what it is answered."""
        self.pass_time(0.004032)
        self.controller.send(**changes)
        return self.serve()

    def serve(self) -> list[Reference]:
        """The server's part of one cycle."""
        state = self.backend.read()
        if state is None:
            self.robot.no_cycle(self.now_ns)
        else:
            self.robot.cycle(state, self.now_ns)
        return self.controller.collect()

    def run(self, cycles: int, *, follow: bool = True, **changes: object) -> list[Reference]:
        """So many cycles, in which the arm goes where it was told to, if it may."""
        answers = []
        for _ in range(cycles):
            got = self.cycle(**changes)
            answers += got
            if got and follow:
                self.controller.packet.axes = tuple(got[-1].axes)
                self.controller.packet.axis_7 = tuple(got[-1].axis_7)
        return answers

    def ready(self) -> Bench:
        self.run(RAMP_CYCLES)
        assert self.backend.readiness() is None
        return self

    def armed(self) -> Bench:
        self.ready()
        self.requests.arm(OURS, self.now_ns)
        return self

    def moving(self, size: float = 0.03) -> np.ndarray:
        """Armed and with a motion under way; returns its samples, rad."""
        self.armed()
        start = np.array(self.robot.arm_motion.commanded_position())
        motion = self.motion(start, start + size * np.array([1, -0.5, 0, 0.5, 0, 1, 0]))
        self.send_chunk(motion.trajectory)
        self.run(15)
        assert self.robot.state is ServerState.EXECUTING
        return np.asarray(motion.trajectory.q)

    def motion(self, start: np.ndarray, goal: np.ndarray) -> StartMotion:
        """From rest to rest, no faster than the bridge admits."""
        return StartMotion(start, goal, LAB, flange_speed=min(self.backend.admitted_speed, 0.25))

    def send_chunk(self, trajectory: object) -> None:
        self.sequence += 1
        stamp_ns = (self.robot.clock_ns // GRID_NS + 3) * GRID_NS
        chunk = TrajectoryChunk.of(stamp_ns, self.backend.joint_names, trajectory)  # type: ignore[arg-type]
        accepted = self.robot.receive(encode_chunk(chunk), OURS, self.sequence, self.now_ns)
        assert accepted, self.robot.refusals.take()


@pytest.fixture
def bench() -> Iterator[Bench]:
    opened = Bench()
    yield opened
    opened.close()


def in_degrees(answers: list[Reference]) -> np.ndarray:
    return np.array([answer.chain() for answer in answers])


def test_before_the_first_packet_it_says_what_is_missing(bench: Bench) -> None:
    assert bench.backend.read() is None
    assert "no packet" in str(bench.robot.not_ready())
    with pytest.raises(CommandRefusedError, match="no packet"):
        bench.requests.arm(OURS, 0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"motors": MOTORS_OFF, "rapid": RAPID_STOPPED, "mci": MCI_STOPPED}, "motors"),
        ({"rapid": RAPID_STOPPED, "mci": MCI_STOPPED}, "RAPID"),
        ({"mci": MCI_STOPPED}, "EGM is not running"),
        ({"mci": MCI_ERROR}, "EGM error"),
        ({"clock": None}, "6.07.01"),
        ({}, "ramp"),
    ],
)
def test_arming_is_refused_with_what_is_missing(
    bench: Bench, changes: dict[str, object], words: str
) -> None:
    bench.run(3, **changes)
    with pytest.raises(CommandRefusedError, match=words):
        bench.requests.arm(OURS, bench.now_ns)
    assert bench.robot.state is ServerState.DISARMED


def test_a_restarted_controller_with_undefined_rapid_can_be_commanded(bench: Bench) -> None:
    bench.run(RAMP_CYCLES, rapid=RAPID_UNDEFINED)
    bench.requests.arm(OURS, bench.now_ns)


def test_disarmed_it_holds_so_that_the_session_lives(bench: Bench) -> None:
    bench.ready()
    answers = bench.run(50)
    assert len(answers) == 50
    np.testing.assert_allclose(in_degrees(answers), np.tile(CHAIN, (50, 1)), atol=1e-9)
    sequences = [answer.sequence for answer in answers]
    assert sequences == list(range(sequences[0], sequences[0] + 50))


@pytest.mark.parametrize("joint", range(7))
def test_each_joint_of_a_chunk_moves_its_axis(bench: Bench, joint: int) -> None:
    bench.armed()
    start = np.array(bench.robot.arm_motion.commanded_position())
    goal = start.copy()
    goal[joint] += 0.05
    bench.send_chunk(bench.motion(start, goal).trajectory)
    answers = bench.run(200)
    moved = in_degrees(answers)[-1] - CHAIN
    assert moved[joint] == pytest.approx(np.degrees(0.05), abs=1e-6)
    assert np.abs(np.delete(moved, joint)).max() < 1e-9
    speeds = np.array([[*a.speeds[:2], *a.speed_7, *a.speeds[2:]] for a in answers if a.speeds])
    assert speeds[:, joint].max() > 5.0
    assert np.abs(np.delete(speeds, joint, axis=1)).max() < 1e-9


def test_references_are_the_plan_at_the_controllers_own_times(bench: Bench) -> None:
    samples = bench.moving()
    answers = in_degrees(bench.run(200))
    # Cycles of 4.032 ms sample a plan on a grid of 4 ms: between its points, never beyond them.
    low, high = np.degrees(samples.min(axis=0)), np.degrees(samples.max(axis=0))
    assert (answers >= low - 1e-9).all()
    assert (answers <= high + 1e-9).all()
    np.testing.assert_allclose(answers[-1], np.degrees(samples[-1]), atol=1e-9)
    assert bench.robot.state is ServerState.HOLDING


def test_speed_references_are_the_slope_of_positions_in_true_time(bench: Bench) -> None:
    bench.moving(size=0.2)
    answers = bench.run(60)
    q = in_degrees(answers)
    v = np.array([[*a.speeds[:2], *a.speed_7, *a.speeds[2:]] for a in answers])
    slope = np.diff(q, axis=0) / 0.004032
    middle = 0.5 * (v[1:] + v[:-1])
    assert np.abs(v).max() > 10.0
    np.testing.assert_allclose(middle, slope, atol=0.02 * np.abs(v).max())


@pytest.mark.parametrize("feed_forward", [0.0, 0.5])
def test_feed_forward_can_be_less(feed_forward: float) -> None:
    options = EgmOptions(listen="127.0.0.1:0", listen_left="none", feed_forward=feed_forward)
    bench = Bench(options)
    bench.moving(size=0.1)
    answers = bench.run(30)
    fastest = max((max(map(abs, a.speeds)) for a in answers if a.speeds), default=0.0)
    command = bench.backend.command
    assert command is not None
    if feed_forward == 0.0:
        assert fastest == 0.0
    else:
        assert np.degrees(feed_forward * np.abs(command.v)).max() == pytest.approx(
            max(map(abs, [*answers[-1].speeds, *answers[-1].speed_7]))
        )
    bench.close()


def test_lost_packets_leave_out_a_part_of_the_plan_and_change_no_speed(bench: Bench) -> None:
    bench.moving(size=0.2)
    before = in_degrees(bench.run(5))[-1]
    bench.controller.lose(4)
    bench.pass_time(4 * 0.004032)
    after = in_degrees(bench.run(1))[-1]
    command = bench.backend.command
    assert command is not None
    np.testing.assert_allclose(after - before, 5 * 0.004032 * np.degrees(command.v), rtol=0.1)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"motors": MOTORS_OFF}, "motors"),
        ({"rapid": RAPID_STOPPED, "mci": MCI_STOPPED}, "RAPID"),
        ({"mci": MCI_STOPPED}, "EGM is not running"),
    ],
)
def test_what_ends_guiding_in_motion_is_a_fault_and_the_plan_is_forgotten(
    bench: Bench, changes: dict[str, object], words: str
) -> None:
    bench.moving()
    bench.run(1, follow=False, **changes)
    assert bench.robot.state is ServerState.FAULT
    assert words in bench.robot.machine.reason
    # Somebody moves the arm by hand: the plan follows it, and so do the references.
    bench.controller.packet.axes = (5.0, *bench.controller.packet.axes[1:])
    answers = bench.run(3, follow=False, **changes)
    assert in_degrees(answers)[-1][0] == pytest.approx(5.0)
    assert bench.robot.arm_motion.commanded_position()[0] == pytest.approx(radians(5.0))
    # Guided again: from there, at rest, and nobody commands before arming anew.
    answers = bench.run(RAMP_CYCLES, follow=False)
    assert in_degrees(answers)[:, 0] == pytest.approx(5.0)
    bench.requests.stop("test")
    assert bench.robot.state is ServerState.DISARMED
    bench.requests.arm(OURS, bench.now_ns)


def test_a_session_that_ends_at_rest_is_no_fault(bench: Bench) -> None:
    bench.armed()
    assert bench.robot.state is ServerState.HOLDING
    bench.run(10, mci=MCI_STOPPED)
    assert bench.robot.state is ServerState.DISARMED
    assert "EGM is not running" in bench.robot.machine.reason
    bench.controller.restart()
    bench.run(RAMP_CYCLES)
    bench.requests.arm(OURS, bench.now_ns)


@pytest.mark.parametrize("how", ["sequence", "new port", "clock"])
def test_a_restart_in_motion_starts_from_feedback_and_needs_a_new_arming(
    bench: Bench, how: str
) -> None:
    bench.moving()
    if how == "new port":
        bench.pass_time(0.2)
    if how == "clock":
        bench.controller.cycles += 1000
        bench.pass_time(0.15)
    bench.controller.restart(new_port=how == "new port")
    here = bench.controller.packet.axes
    answers = bench.run(3, follow=False)
    assert bench.robot.state is ServerState.FAULT
    for answer in answers:
        assert answer.axes == pytest.approx(here)
        assert answer.speeds == []
    with pytest.raises(CommandRefusedError):
        bench.requests.arm(OURS, bench.now_ns)


@pytest.mark.parametrize("silent_s", [0.004, 0.02, 0.05, 0.09])
def test_short_silences_are_none(bench: Bench, silent_s: float) -> None:
    bench.moving(size=0.2)
    bench.pass_time(silent_s)
    bench.serve()
    assert bench.robot.state is ServerState.EXECUTING
    bench.controller.lose(round(silent_s / 0.004032))
    bench.run(5)
    assert bench.robot.state is ServerState.EXECUTING


@pytest.mark.parametrize("silent_s", [0.1, 0.5, 2.0])
def test_long_silences_are_a_fault_and_can_be_ended(bench: Bench, silent_s: float) -> None:
    bench.moving()
    bench.pass_time(silent_s)
    assert bench.serve() == []
    assert bench.robot.state is ServerState.FAULT
    assert "no packet" in bench.robot.machine.reason
    # The plan has ended where the arm was last seen: a stop is not refused, the server can end.
    assert bench.robot.at_rest
    bench.requests.stop("test")
    assert bench.robot.state is ServerState.DISARMED
    bench.controller.lose(round(silent_s / 0.004032))
    here = bench.controller.packet.axes
    answers = bench.run(3, follow=False)
    assert answers[0].axes == pytest.approx(here)
    bench.ready()


def test_an_overload_lets_the_plan_end_and_is_told(bench: Bench) -> None:
    bench.moving(size=0.2)
    bench.run(40, utilization=150.0)
    assert bench.robot.state is ServerState.FAULT
    assert "utilisation" in bench.robot.machine.reason
    bench.run(200, utilization=150.0)
    assert bench.robot.at_rest


def test_a_hundred_peaks_are_no_overload(bench: Bench) -> None:
    bench.armed()
    for _ in range(100):
        bench.run(1, utilization=900.0)
        bench.run(2, utilization=30.0)
    assert bench.robot.state is ServerState.HOLDING


def test_commanded_speed_of_the_flange_is_bounded_by_what_it_may_run_on() -> None:
    slow = ProgramSettings(gain=5.0, comm_timeout_s=1.0, ramp_out_s=0.5)
    options = EgmOptions(listen="127.0.0.1:0", listen_left="none", program=slow)
    assert options.admitted_speed == pytest.approx(0.010 / slow.runs_on_s(1.0))
    bench = Bench(options)
    bench.armed()
    start = np.array(bench.robot.arm_motion.commanded_position())
    goal = start + 0.3 * np.array([1, 0, 0, 0, 0, 0, 0])
    chunk = TrajectoryChunk.of(
        (bench.robot.clock_ns // GRID_NS + 3) * GRID_NS,
        bench.backend.joint_names,
        StartMotion(start, goal, LAB).trajectory,
    )
    assert not bench.robot.receive(encode_chunk(chunk), OURS, 1, bench.now_ns)
    assert "tool speed" in bench.robot.refusals.take()[0].reason
    bench.close()


def test_status_tells_of_controller_session_and_run_on(bench: Bench) -> None:
    bench.moving(size=0.2)
    answers = bench.run(30, utilization=42.0)
    told = bench.backend.told()
    assert told["egm"] == "guiding"
    assert told["egm_missing"] == ""
    assert (told["motors"], told["rapid"], told["mci"]) == ("on", "running", "running")
    assert (told["robotware"], told["utilization"], told["session"]) == ("6", "42", "1")
    assert float(told["rate_hz"]) == pytest.approx(248.0, rel=0.1)
    assert (told["missed"], told["gripper"], told["left_arm"]) == ("0", "ready", "not watched")
    assert float(told["late_fraction"]) <= 1.0
    assert answers
    assert 0.0 < float(told["runs_on_mm"]) <= 1e3 * bench.options.run_on_limit
    bench.run(300)
    assert bench.backend.told()["runs_on_mm"] == "0.00"


class TestLeftArm:
    """The other arm: answered, watched, and compared with where the guard has it."""

    HOME = (0.0, -130.0, 30.0, 0.0, 40.0, 0.0)

    @pytest.fixture
    def both(self) -> Iterator[tuple[Bench, HandController]]:
        bench = Bench(EgmOptions(listen="127.0.0.1:0", listen_left="127.0.0.1:0"))
        assert bench.backend.left is not None
        bench.backend.left.channel.link.now_ns = lambda: bench.now_ns
        left = HandController(bench.backend.left.channel.link.address, self.HOME, 135.0)
        yield bench, left
        left.socket.close()
        bench.close()

    def run(self, both: tuple[Bench, HandController], cycles: int) -> list[Reference]:
        bench, left = both
        answers = []
        for _ in range(cycles):
            left.send()
            bench.run(1)
            answers += left.collect(1.0)
        return answers

    def test_it_is_held_where_it_is(self, both: tuple[Bench, HandController]) -> None:
        answers = self.run(both, RAMP_CYCLES)
        assert len(answers) == RAMP_CYCLES
        assert answers[-1].chain() == pytest.approx([0.0, -130.0, 135.0, 30.0, 0.0, 40.0, 0.0])
        bench, _ = both
        assert bench.backend.readiness() is None
        assert "at home" in bench.backend.told()["left_arm"]

    def test_its_joints_are_told_behind_the_right_arms(
        self, both: tuple[Bench, HandController]
    ) -> None:
        bench, left = both
        bench.run(3)
        assert len(bench.backend.state_names) == 8
        for step in range(20):
            left.packet.axes = (0.1 * step, *self.HOME[1:])
            self.run(both, 1)
        state = bench.robot.arm_motion.state
        assert state is not None
        assert bench.backend.state_names[8:] == yumi.joint_names("left")
        assert len(state.position) == len(state.velocity) == len(state.effort) == 15
        assert np.degrees(state.position[8]) == pytest.approx(1.8, abs=0.11)
        assert np.degrees(state.velocity[8]) == pytest.approx(0.1 / 0.004032, rel=0.1)

    def test_one_that_is_not_parked_refuses_to_arm(
        self, both: tuple[Bench, HandController]
    ) -> None:
        bench, left = both
        left.packet.axes = (0.0, -110.0, 30.0, 0.0, 40.0, 0.0)
        self.run(both, RAMP_CYCLES)
        with pytest.raises(CommandRefusedError, match=r"left arm's axis 2 is 20\.0 deg"):
            bench.requests.arm(OURS, bench.now_ns)
        left.packet.axes = self.HOME
        self.run(both, 5)
        bench.requests.arm(OURS, bench.now_ns)

    def test_one_that_was_never_heard_of_is_told(self, both: tuple[Bench, HandController]) -> None:
        bench, _ = both
        bench.ready()
        assert "taken to be at home" in bench.backend.told()["left_arm"]


def test_the_registry_makes_it() -> None:
    egm = EgmOptions(listen="127.0.0.1:0", listen_left="none")
    backend = make_backend("egm", BackendOptions(egm=egm))
    assert backend.name == "egm"
    assert backend.scene is None
    assert backend.state_names == yumi.joint_names("right")
    for wrong in ({"lock_step": True}, {"variation": "randomised"}):
        with pytest.raises(ConfigurationError):
            make_backend("egm", BackendOptions(egm=egm, **wrong))  # type: ignore[arg-type]


def test_a_taken_port_and_a_wrong_address_are_told(bench: Bench) -> None:
    host, port = bench.link.address
    for listen, error in ((f"{host}:{port}", TransportError), ("nowhere", ConfigurationError)):
        other = EgmBackend(EgmOptions(listen=listen, listen_left="none"))
        with pytest.raises(error):
            other.open(lambda: True)


@pytest.mark.parametrize("wrong", [{"feed_forward": 1.1}, {"run_on_limit": 0.0}])
def test_options_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigurationError):
        EgmOptions(**wrong)  # type: ignore[arg-type]


def test_waiting_for_packets_ends(bench: Bench) -> None:
    started_s = time.monotonic()
    assert bench.backend.read() is None
    assert time.monotonic() - started_s < 5.0
