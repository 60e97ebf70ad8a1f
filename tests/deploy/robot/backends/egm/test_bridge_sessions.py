"""What the bridge does where a session of its controller begins, ends, or falls silent."""

from __future__ import annotations

from math import radians

import pytest
from egm_bench import OURS, RAMP_CYCLES, Bench, in_degrees
from egm_wire import MCI_STOPPED, MOTORS_OFF, RAPID_STOPPED

from skewmi.deploy.robot.states import ServerState
from skewmi.errors import CommandRefusedError


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


@pytest.mark.parametrize("held_up_s", [0.15, 0.2, 0.25])
def test_a_hold_up_that_is_longer_than_the_ramp_is_a_fault_in_motion(
    bench: Bench, held_up_s: float
) -> None:
    """The session begins and is over its ramp within one look at the socket; nothing is jumped."""
    bench.moving(size=0.3)
    before = bench.run(1)[-1]
    for _ in range(round(held_up_s / 0.004032)):
        bench.pass_time(0.004032)
        bench.controller.send()
    answers = bench.serve()
    assert bench.robot.state is ServerState.FAULT
    assert "a session has begun" in bench.robot.machine.reason
    assert len(answers) == 1, "a second one would stay in the controller's queue"
    assert answers[0].chain() == pytest.approx(before.chain(), abs=1e-6)
    assert bench.run(3, follow=False)[-1].chain() == pytest.approx(before.chain(), abs=1e-6)
    bench.requests.stop("test")
    bench.requests.arm(OURS, bench.now_ns)


def test_a_hold_up_at_rest_takes_the_arm_from_its_commander(bench: Bench) -> None:
    bench.armed()
    for _ in range(75):
        bench.pass_time(0.004032)
        bench.controller.send()
    bench.serve()
    assert bench.robot.state is ServerState.DISARMED
    bench.run(2)
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
