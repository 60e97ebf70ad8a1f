"""Which packets of a controller count, how far its clock moved, and where a session begins.

Pure: `judge` looks at one packet and at the one accepted before it. A session *begins* where the
arm may be anywhere and whoever moved it no longer knows: there the reference starts again from the
packet's own feedback, and nobody is armed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from skewmi.deploy.robot.backends.egm.packets import FeedbackPacket, Mci, Motors, Rapid

GAP_NS = 100_000_000
"""So long without a packet ends a session: 25 cycles of the controller."""

MAX_JUMP = 25
"""Packets that may be lost in a row within a session; more is `GAP_NS` of the controller."""

OLDEST_ROBOTWARE = "6.07.01"

_SEQUENCE_RANGE = 1 << 32


@dataclass(frozen=True)
class Received:
    """A packet as it came in.

    Attributes:
        packet: What it says.
        sender: Address and port it came from.
        arrival_ns: When it reached this computer, by any monotonic clock.
        read_ns: When this process came to it, by the same clock.
    """

    packet: FeedbackPacket
    sender: tuple[str, int]
    arrival_ns: int
    read_ns: int


class Accepted(NamedTuple):
    """A packet that counts.

    `ticks` are controller cycles since the accepted one before it, 1 if none was lost; `begins`
    says why a session begins with it, and is empty if none does.
    """

    ticks: int
    begins: str


class Ignored(NamedTuple):
    """A packet that is neither answered nor used, and why."""

    why: str


def judge(received: Received, previous: Received | None) -> Accepted | Ignored:
    """What a packet means after the one that was accepted before it.

    Args:
        received: The packet, decoded, from the controller's address.
        previous: The newest accepted one; None at first.
    """
    packet = received.packet
    if packet.clock_us is None:
        return Ignored(
            f"the controller's RobotWare is older than {OLDEST_ROBOTWARE} (its packets have no "
            "time): it mixes radians and degrees; update it"
        )
    if previous is None:
        return Accepted(1, "the first packet")
    silent_ns = received.arrival_ns - previous.arrival_ns
    if silent_ns >= GAP_NS:
        return Accepted(1, f"no packet for {silent_ns / 1e9:.2g} s")
    held_up_ns = received.read_ns - previous.read_ns
    if held_up_ns >= GAP_NS:
        # The controller has been without references all the same, and the arm ran on.
        return Accepted(1, f"this computer was held up for {held_up_ns / 1e9:.2g} s")
    if received.sender != previous.sender:
        return Ignored(
            f"it came from {_address(received.sender)} while {_address(previous.sender)} is sending"
        )
    return _judge_order(packet, previous.packet)


def _judge_order(packet: FeedbackPacket, before: FeedbackPacket) -> Accepted | Ignored:
    """Of one sender, without a gap: by its sequence numbers and its clock."""
    assert packet.clock_us is not None
    assert before.clock_us is not None
    ticks = (packet.sequence - before.sequence) % _SEQUENCE_RANGE
    later = packet.clock_us > before.clock_us
    if ticks == 0 and not later:
        return Ignored("a duplicate")
    if ticks == 0 or ticks >= _SEQUENCE_RANGE // 2:
        # Behind in sequence: an old packet that was overtaken, unless the clock went on.
        if not later:
            return Ignored("overtaken by a newer one")
        return Accepted(1, f"the sequence starts again at {packet.sequence}")
    if ticks > MAX_JUMP:
        return Accepted(1, f"the sequence jumped by {ticks}")
    if packet.guided and not before.guided:
        return Accepted(ticks, "the controller follows references from now on")
    return Accepted(ticks, "")


def not_guiding(packet: FeedbackPacket) -> str | None:
    """Which step is missing before a controller that sends packets follows references, or None."""
    if packet.motors is not Motors.ON:
        return "the motors are off; switch them on (FlexPendant: Motors On, automatic mode)"
    if packet.rapid is Rapid.STOPPED:
        after = ", after an EGM error (its event log says which)" if packet.mci is Mci.ERROR else ""
        return f"the RAPID program is stopped{after}; start it (PP to Main, Start)"
    if packet.mci is Mci.ERROR:
        return "the controller reports an EGM error; its event log says which"
    if packet.mci is not Mci.RUNNING:
        return "EGM is not running (MCI stopped); the program has not come to its EGMRunJoint"
    return None


def _address(sender: tuple[str, int]) -> str:
    return f"{sender[0]}:{sender[1]}"
