"""An arm's channel against a controller written by hand: which packets are answered, and how."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
from egm_channel import RAMP_NS, Controller, guided, take
from egm_controller import HandController
from egm_wire import MCI_STOPPED, MOTORS_OFF, RAPID_STOPPED

from skewmi.deploy.robot.backends.egm.channel import ArmChannel
from skewmi.deploy.robot.backends.egm.link import DRAINED_AT_ONCE, UdpLink
from skewmi.deploy.robot.backends.egm.session import GAP_NS
from skewmi.deploy.robot.backends.egm.states import EgmState

HOME_CHAIN = [0.0, -130.0, -135.0, 30.0, 0.0, 40.0, 0.0]


def test_the_first_packet_is_answered_with_its_own_feedback(
    channel: ArmChannel, controller: Controller
) -> None:
    controller.send()
    taken = take(channel)
    assert taken is not None
    assert taken.begins
    channel.hold()
    (answer,) = controller.collect(1.0)
    assert answer.chain() == pytest.approx(HOME_CHAIN, abs=1e-9)
    assert answer.speeds == []


def test_one_packet_one_answer(channel: ArmChannel, controller: Controller) -> None:
    controller.send()
    take(channel)
    channel.hold()
    channel.hold()
    channel.answer(np.zeros(7), None)
    assert len(controller.collect(0.5)) == 1
    assert controller.collect(0.005) == []


def test_only_the_newest_of_a_burst_is_answered(
    channel: ArmChannel, controller: Controller
) -> None:
    guided(channel, controller)
    for _ in range(5):
        controller.send()
    time.sleep(0.02)
    taken = take(channel)
    assert taken is not None
    assert taken.skipped == 4
    assert taken.packet.sequence == controller.sequence - 1
    channel.hold()
    assert len(controller.collect(1.0)) == 1
    assert channel.watch.statistics.missed == 0


def test_after_a_hold_up_there_is_one_answer_however_much_has_come(
    channel: ArmChannel, controller: Controller
) -> None:
    guided(channel, controller)
    for _ in range(3 * DRAINED_AT_ONCE + 10):
        controller.send()
    time.sleep(0.05)
    for _ in range(5):
        channel.link.wait(20_000_000)
        if channel.take() is not None:
            channel.hold()
    assert len(controller.collect(0.2)) == 1


def test_a_packet_that_comes_as_silence_is_noticed_begins_a_session(
    channel: ArmChannel, controller: Controller
) -> None:
    """It is of no silence by its own time: nothing else would ever end this one."""
    guided(channel, controller)
    channel.watch.note_time(channel.link.now_ns() + GAP_NS)
    assert channel.watch.state is EgmState.SILENT
    controller.packet.axes = (20.0, *controller.packet.axes[1:])
    controller.send()
    taken = take(channel)
    assert taken is not None
    assert taken.begins == "packets come again"
    channel.hold()
    assert controller.collect(1.0)[-1].axes[0] == pytest.approx(20.0)
    assert channel.watch.state is EgmState.RAMPING


def test_packets_of_a_session_that_is_known_to_be_over_begin_none(
    channel: ArmChannel, controller: Controller
) -> None:
    guided(channel, controller)
    channel.watch.expect_session("the scene was reset")
    controller.send()
    taken = take(channel)
    assert taken is not None
    assert not taken.begins
    assert channel.watch.state is EgmState.SILENT


def test_duplicates_and_overtaken_packets_are_not_answered(
    channel: ArmChannel, controller: Controller
) -> None:
    guided(channel, controller)
    late = controller.bytes_of()
    newest = controller.send()
    assert take(channel) is not None
    channel.hold()
    assert len(controller.collect(1.0)) == 1
    for data in (newest, newest, late):
        controller.send_bytes(data)
        assert take(channel) is None
        channel.hold()
    assert controller.collect(0.005) == []
    assert channel.watch.statistics.ignored == 3
    assert channel.readiness() is None


def test_reordering_within_a_cycle_costs_nothing(
    channel: ArmChannel, controller: Controller
) -> None:
    guided(channel, controller)
    first, second = controller.bytes_of(), controller.bytes_of()
    controller.send_bytes(second)
    controller.send_bytes(first)
    time.sleep(0.02)
    taken = take(channel)
    assert taken is not None
    assert taken.packet.sequence == controller.sequence - 1
    channel.hold()
    assert len(controller.collect(1.0)) == 1


def test_lost_packets_are_counted(channel: ArmChannel, controller: Controller) -> None:
    guided(channel, controller)
    controller.lose(3)
    controller.send()
    taken = take(channel)
    assert taken is not None
    assert taken.begins == ""
    assert channel.watch.statistics.missed == 3


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"motors": MOTORS_OFF}, "motors"),
        ({"rapid": RAPID_STOPPED}, "RAPID"),
        ({"mci": MCI_STOPPED}, "EGM is not running"),
    ],
)
def test_while_it_is_not_guided_the_reference_follows_the_arm(
    channel: ArmChannel, controller: Controller, changes: dict[str, int], word: str
) -> None:
    guided(channel, controller)
    for moved in (1.0, 2.0, 3.0):
        controller.packet.axes = (moved, *controller.packet.axes[1:])
        controller.send(**changes)
        assert take(channel) is not None
        channel.hold()
        (answer,) = controller.collect(1.0)
        assert answer.axes[0] == pytest.approx(moved)
    assert word in str(channel.readiness())
    controller.send()
    taken = take(channel)
    assert taken is not None
    assert "from now on" in taken.begins
    channel.hold()
    assert controller.collect(1.0)[0].axes[0] == pytest.approx(3.0)
    assert channel.watch.state is EgmState.RAMPING


def test_a_guided_arm_is_held_where_its_session_began(
    channel: ArmChannel, controller: Controller
) -> None:
    guided(channel, controller)
    # It sags a little: the reference must not follow.
    controller.packet.axes = (-0.5, *controller.packet.axes[1:])
    controller.send()
    take(channel)
    channel.hold()
    assert controller.collect(1.0)[0].axes[0] == pytest.approx(0.0)


@pytest.mark.parametrize("how", ["sequence", "new port", "gap"])
def test_a_new_session_starts_from_its_own_feedback(
    channel: ArmChannel, controller: Controller, how: str
) -> None:
    guided(channel, controller)
    controller.packet.axes = (20.0, *controller.packet.axes[1:])
    if how == "sequence":
        controller.restart()
    else:
        controller.clock.wait(0.12)
        if how == "new port":
            controller.restart(new_port=True)
    controller.send()
    taken = take(channel)
    assert taken is not None
    assert taken.begins
    channel.hold()
    (answer,) = controller.collect(1.0)
    assert answer.axes[0] == pytest.approx(20.0)
    assert channel.watch.sessions == 2
    assert "ramp" in str(channel.readiness())


def test_another_sender_is_not_listened_to(channel: ArmChannel, controller: Controller) -> None:
    guided(channel, controller)
    with HandController(channel.link.address) as stranger:
        stranger.sequence, stranger.cycles = controller.sequence, controller.cycles
        stranger.send()
        assert take(channel) is None
        channel.hold()
        assert stranger.collect(0.005) == []
    controller.send()
    assert take(channel) is not None
    assert channel.readiness() is None


def test_another_host_is_told(controller: Controller) -> None:
    with UdpLink.open(("127.0.0.1", 0)) as link:
        channel = ArmChannel(link, RAMP_NS, controller="192.168.125.1")
        with HandController(link.address) as stranger:
            stranger.send()
            assert take(channel) is None
        assert "127.0.0.1" in str(channel.readiness())
        assert "192.168.125.1" in str(channel.readiness())


def test_old_robotware_is_refused(channel: ArmChannel, controller: Controller) -> None:
    controller.send(clock=None)
    assert take(channel) is None
    channel.hold()
    assert controller.collect(0.005) == []
    assert "6.07.01" in str(channel.readiness())


@pytest.mark.parametrize("value", [math.nan, math.inf, 400.0])
def test_no_feedback_gets_something_wrong_out(
    channel: ArmChannel, controller: Controller, value: float
) -> None:
    controller.packet.axes = (value, *controller.packet.axes[1:])
    controller.send()
    take(channel)
    channel.hold()
    assert controller.collect(0.005) == []
    assert channel.readiness() is not None


@pytest.mark.parametrize("value", [math.nan, math.inf, 10.0])
def test_no_plan_gets_something_wrong_out(
    channel: ArmChannel, controller: Controller, value: float
) -> None:
    guided(channel, controller)
    q = np.radians(HOME_CHAIN)
    for part in range(2):
        controller.send()
        take(channel)
        wrong, v = q.copy(), np.zeros(7)
        (wrong if part == 0 else v)[3] = value
        channel.answer(wrong, v)
        assert controller.collect(0.005) == []
        assert "no reference can be sent" in str(channel.readiness())
    controller.send()
    take(channel)
    channel.answer(q, None)
    assert len(controller.collect(1.0)) == 1
    assert channel.readiness() is None


def test_silence_is_told(channel: ArmChannel, controller: Controller) -> None:
    guided(channel, controller)
    controller.clock.wait(0.11)
    assert channel.take() is None
    assert "no packet" in str(channel.readiness())
