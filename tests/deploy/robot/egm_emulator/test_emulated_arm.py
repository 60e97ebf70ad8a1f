"""The emulated controller's programs: sessions, their ends, and what packets say of them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from skewmi.deploy.robot.backends.egm.packets import (
    FeedbackPacket,
    Mci,
    Motors,
    Rapid,
    ReferencePacket,
)
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.egm_emulator.controller_states import ARM_TABLE, ArmEvent, ArmState
from skewmi.deploy.robot.egm_emulator.emulated_arm import ArmOptions, EmulatedArm
from skewmi.robot_models import yumi
from skewmi.robot_models.frames import rotation_from_quaternion
from skewmi.robot_models.kinematics import ArmKinematics

PERIOD_S = 0.004032
HOME = np.array(yumi.HOME["right"])

Answer = Callable[[FeedbackPacket], ReferencePacket | None]


class Bench:
    """An arm that goes where its controller wants it, and a partner who answers each packet."""

    def __init__(self, *, robotware: int = 6, lag_s: float = 0.0, **settings: object) -> None:
        options = ArmOptions(
            "right",
            ProgramSettings(**settings),  # type: ignore[arg-type]
            PERIOD_S,
            lag_s,
            robotware,
        )
        self.arm = EmulatedArm(options, HOME)
        self.q = HOME.copy()
        self.packets: list[FeedbackPacket] = []

    def run(self, seconds: float, answer: Answer | None = None) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            reference = None
            if self.arm.sending:
                packet = self.arm.packet(self.q)
                self.packets.append(packet)
                reference = None if answer is None else answer(packet)
            self.q = self.arm.cycle(reference).q

    def guided(self) -> Bench:
        self.arm.start()
        self.run(0.5, hold)
        assert self.arm.state is ArmState.GUIDED
        return self


def hold(packet: FeedbackPacket) -> ReferencePacket:
    """Stay where the session began."""
    return ReferencePacket(packet.sequence, 0, HOME, np.zeros(7))


def to(q: np.ndarray) -> Answer:
    return lambda packet: ReferencePacket(packet.sequence, 0, q, None)


def test_a_program_comes_to_egm_step_by_step() -> None:
    bench = Bench()
    bench.run(0.1)
    assert bench.packets == []
    bench.guided()
    assert bench.packets[0].sequence == 0
    assert [p.sequence for p in bench.packets] == list(range(len(bench.packets)))
    states = [(p.motors, p.rapid, p.mci) for p in bench.packets]
    assert states[0] == (Motors.ON, Rapid.RUNNING, Mci.STOPPED)
    assert states[-1] == (Motors.ON, Rapid.RUNNING, Mci.RUNNING)
    assert all(packet.clock_us is not None for packet in bench.packets)


@pytest.mark.parametrize("robotware", [6, 7])
def test_packets_have_all_that_clients_ask_for(robotware: int) -> None:
    bench = Bench(robotware=robotware).guided()
    packet = bench.packets[-1]
    assert packet.robotware == robotware
    assert (packet.move_index is not None) == (robotware == 7)
    for pose, q in ((packet.flange, packet.q), (packet.planned_flange, packet.planned_q)):
        position, rotation = ArmKinematics("right").forward(q)
        assert pose is not None
        np.testing.assert_allclose(pose.position, position, atol=1e-12)
        turned = rotation_from_quaternion(pose.quaternion_wxyz)
        np.testing.assert_allclose(turned, rotation, atol=1e-12)
    assert packet.utilization is not None


def test_references_move_the_arm_only_while_guided() -> None:
    goal = HOME + 0.05
    bench = Bench()
    bench.arm.start()
    bench.run(0.22, to(goal))
    np.testing.assert_array_equal(bench.q, HOME)
    bench.run(2.0, to(goal))
    np.testing.assert_allclose(bench.q, goal, atol=1e-6)


def test_nobody_answers_and_the_program_starts_over() -> None:
    bench = Bench(comm_timeout_s=0.1).guided()
    bench.run(1.0)
    assert bench.arm.sessions >= 2
    assert any("41822" in error for error in bench.arm.errors)
    restarts = [p for p in bench.packets if p.sequence == 0]
    assert len(restarts) >= 2
    bench.run(0.5, hold)
    assert bench.arm.state is ArmState.GUIDED


@pytest.mark.parametrize("silent_s", [0.02, 0.09])
def test_a_short_silence_is_none(silent_s: float) -> None:
    bench = Bench(comm_timeout_s=0.1).guided()
    bench.run(silent_s)
    bench.run(0.1, hold)
    assert bench.arm.sessions == 1
    assert bench.arm.errors == []


def test_a_resting_arm_converges_and_its_session_ends() -> None:
    bench = Bench(convergence_deg=0.5, cond_time_s=1.0)
    bench.arm.start()
    bench.run(2.0, hold)
    assert bench.arm.sessions == 2
    assert any(packet.converged for packet in bench.packets)
    assert bench.arm.errors == []


def test_motors_off_for_good_ends_the_session() -> None:
    bench = Bench().guided()
    bench.arm.switch_motors(on=False)
    bench.run(0.1, hold)
    bench.arm.switch_motors(on=True)
    bench.run(0.5, hold)
    assert bench.arm.state is ArmState.STOPPED
    bench.arm.start()
    bench.run(0.5, hold)
    assert bench.arm.sessions == 2
    assert bench.arm.state is ArmState.GUIDED


def test_with_the_default_parameter_the_same_session_goes_on() -> None:
    bench = Bench(do_not_restart_after_motors_off=False).guided()
    count = bench.packets[-1].sequence
    bench.arm.switch_motors(on=False)
    bench.run(0.1, hold)
    assert bench.packets[-1].motors is Motors.OFF
    assert bench.packets[-1].mci is Mci.STOPPED
    bench.arm.start()
    assert bench.arm.state is ArmState.SUSPENDED
    bench.arm.switch_motors(on=True)
    bench.arm.start()
    bench.run(0.1, hold)
    # No new sequence: only the states tell that the arm is guided again.
    assert bench.packets[-1].sequence > count
    assert bench.packets[-1].mci is Mci.RUNNING
    assert bench.arm.sessions == 1


def test_a_stopped_program_goes_on_in_the_same_session() -> None:
    bench = Bench().guided()
    bench.arm.stop()
    bench.run(0.1, hold)
    assert (bench.packets[-1].rapid, bench.packets[-1].mci) == (Rapid.STOPPED, Mci.STOPPED)
    bench.arm.start()
    bench.run(0.1, hold)
    assert bench.arm.sessions == 1
    assert bench.packets[-1].mci is Mci.RUNNING


def test_stopping_in_motion_stops_the_arm() -> None:
    bench = Bench(lag_s=0.02).guided()
    bench.run(0.1, to(HOME + 0.2))
    bench.arm.switch_motors(on=False)
    stopped_at = bench.q.copy()
    bench.run(0.2, to(HOME + 0.2))
    np.testing.assert_allclose(bench.q, stopped_at, atol=1e-12)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("of_speed", [False, True])
def test_what_is_no_number_brings_the_controller_down(value: float, of_speed: bool) -> None:
    bench = Bench().guided()

    def answer(packet: FeedbackPacket) -> ReferencePacket:
        q, v = HOME.copy(), np.zeros(7)
        (v if of_speed else q)[3] = value
        return ReferencePacket(packet.sequence, 0, q, v)

    bench.run(0.1, answer)
    assert bench.arm.state is ArmState.DOWN
    assert "10014" in bench.arm.errors[-1]
    count = len(bench.packets)
    bench.arm.start()
    bench.run(0.5, hold)
    assert len(bench.packets) == count
    assert np.isfinite(bench.q).all()
    bench.arm.restart_controller(bench.q)
    bench.arm.start()
    bench.run(0.5, hold)
    assert bench.arm.state is ArmState.GUIDED


def test_out_of_range_ends_the_session_and_every_one_that_starts_so() -> None:
    bench = Bench().guided()
    outside = HOME.copy()
    outside[3] = yumi.POSITION_UPPER[3] + 0.01
    bench.run(0.1, to(outside))
    assert bench.arm.state is ArmState.FAILED
    assert "out of bounds" in bench.arm.errors[-1]
    assert bench.packets[-1].mci is Mci.ERROR
    bench.arm.start()
    bench.run(0.5, to(outside))
    assert bench.arm.state is ArmState.FAILED
    bench.arm.start()
    bench.run(0.5, hold)
    assert bench.arm.state is ArmState.GUIDED


def test_an_arm_that_was_moved_begins_where_it_is() -> None:
    bench = Bench().guided()
    bench.arm.stop()
    bench.run(0.1, hold)
    moved = HOME + 0.3
    bench.arm.place(moved)
    bench.q = moved
    bench.run(0.1)
    np.testing.assert_allclose(bench.packets[-1].q, moved)
    np.testing.assert_allclose(bench.q, moved)


def test_every_state_can_be_left_by_a_restart() -> None:
    for state in ArmState:
        assert ARM_TABLE.next(state, ArmEvent.RESTART) is ArmState.STOPPED
        assert ArmState.GUIDED in ARM_TABLE.reachable(state)
