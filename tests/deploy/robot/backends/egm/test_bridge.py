"""The bridge on the robot server's seam, against a controller written by hand.

Everything but the wires to the session: packets come in, chunks are accepted, references go out.
"""

from __future__ import annotations

import time

import numpy as np
import pytest
from egm_bench import CHAIN, LAB, OURS, RAMP_CYCLES, Bench, in_degrees
from egm_wire import MCI_ERROR, MCI_STOPPED, MOTORS_OFF, RAPID_STOPPED, RAPID_UNDEFINED

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.backends import BackendOptions, make_backend
from skewmi.deploy.robot.backends.egm.backend import EgmBackend
from skewmi.deploy.robot.backends.egm.options import EgmOptions
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.wire.messages import encode_chunk
from skewmi.errors import CommandRefusedError, ConfigurationError, TransportError
from skewmi.robot_models import yumi
from skewmi.trajectory import GRID_NS, TrajectoryChunk


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


def test_shortly_before_a_packet_and_until_it_comes_nothing_is_begun(bench: Bench) -> None:
    bench.ready()
    period_ms = 4.032
    for after_ms in np.arange(0.1, 12.0, 0.25):
        bench.cycle()
        bench.pass_time(after_ms / 1e3)
        assert bench.backend.due() == (abs(after_ms - period_ms) < 1.0), after_ms
        bench.pass_time(-after_ms / 1e3)
    bench.controller.send()
    assert bench.backend.due()


def test_a_controller_that_is_not_there_does_not_put_anything_off(bench: Bench) -> None:
    assert not bench.backend.due()
    bench.ready()
    bench.pass_time(0.5)
    assert not bench.backend.due()


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


def test_commanded_speed_of_the_flange_is_bounded_by_what_it_may_run_on() -> None:
    slow = ProgramSettings(gain=5.0, comm_timeout_s=1.0, ramp_out_s=0.5)
    options = EgmOptions(listen="127.0.0.1:0", listen_left="none", program=slow)
    assert options.admitted_speed == pytest.approx(0.97 * 0.010 / slow.runs_on_s(1.0))
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
