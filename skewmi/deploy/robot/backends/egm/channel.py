"""One arm of a controller: its socket, what it says, and the one answer to each of its packets."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from skewmi.deploy.robot.backends.egm.codec import (
    MalformedPacketError,
    decode_feedback,
    encode_reference,
)
from skewmi.deploy.robot.backends.egm.link import DRAINED_AT_ONCE, Datagram, UdpLink
from skewmi.deploy.robot.backends.egm.outgoing import check_reference
from skewmi.deploy.robot.backends.egm.packets import FeedbackPacket, ReferencePacket
from skewmi.deploy.robot.backends.egm.session import Received
from skewmi.deploy.robot.backends.egm.states import EgmState
from skewmi.deploy.robot.backends.egm.watch import ControllerWatch
from skewmi.deploy.state_machine import Transition
from skewmi.errors import LimitViolationError
from skewmi.trajectory import Array

_log = logging.getLogger(__name__)

_SEQUENCE_RANGE = 1 << 32

_OLD_NS = 20_000_000
"""A datagram that has waited so long is of an earlier cycle: five of the controller's."""

_MOST_DRAINS = 5
"""In one cycle: more than a second of packets, which is as long as their ages are known."""


@dataclass(frozen=True)
class Taken:
    """The newest packet of a cycle.

    Attributes:
        packet: What it says.
        begins: Why a session has begun since the last one; empty if none has.
        skipped: Packets that came in the same cycle and were newer than the last, but not newest.
    """

    packet: FeedbackPacket
    begins: str
    skipped: int


class ArmChannel:
    """Receives an arm's packets and answers the newest of each cycle, once.

    Args:
        link: The bound socket.
        ramp_ns: How long the program takes from the start of a session to full tracking.
        controller: IPv4 address that packets must come from; None takes the first sender's.
        on_transition: Called after every change of the watch's state.
    """

    def __init__(
        self,
        link: UdpLink,
        ramp_ns: int,
        controller: str | None = None,
        on_transition: Callable[[Transition[EgmState]], None] | None = None,
    ) -> None:
        self.link = link
        self.watch = ControllerWatch(ramp_ns, 0, on_transition)
        self.unsendable: str | None = None
        """Why the last packet was not answered, if it was not."""
        self._controller = controller
        self._replies = 0
        self._answered = True
        self._seed: Array | None = None

    @property
    def following(self) -> bool:
        """Whether the arm goes where it is told to: neither moved by others nor ramping in."""
        return self.watch.state is EgmState.GUIDING

    def take(self) -> Taken | None:
        """Take in what has come; None if nothing new has. Notices silence, too."""
        taken: Taken | None = None
        for datagram in self._waiting():
            received = self._decode(datagram)
            if received is None:
                continue
            noted = self.watch.note(received)
            if noted.accepted:
                begins = noted.begins or (taken.begins if taken is not None else "")
                skipped = 0 if taken is None else taken.skipped + 1
                taken = Taken(received.packet, begins, skipped)
        if taken is None:
            self.watch.note_time(self.link.now_ns())
            return None
        if taken.begins or not taken.packet.guided:
            self._seed = taken.packet.q
        self._answered = False
        return taken

    def answer(self, q: Array, v: Array | None) -> None:
        """Answer the packet that `take` gave; a second answer to it is not sent.

        Args:
            q: Where the joints shall be, rad, chain order. Shape (7,).
            v: How fast they shall move there, rad/s; None leaves that to the controller.
        """
        newest = self.watch.newest
        if self._answered or newest is None:
            return
        self._answered = True
        now_ns = self.link.now_ns()
        reference = ReferencePacket(
            self._replies % _SEQUENCE_RANGE, (now_ns // 1_000_000) % _SEQUENCE_RANGE, q, v
        )
        try:
            check_reference(reference)
        except LimitViolationError as error:
            if self.unsendable is None:
                _log.error("no reference is sent: %s", error)
            self.unsendable = f"no reference can be sent: {error}"
            return
        self.unsendable = None
        if self.link.send(encode_reference(reference), newest.sender):
            self._replies += 1
            self.watch.statistics.note_reply(self.link.now_ns() - newest.arrival_ns)
        else:
            self.watch.statistics.unsent += 1

    def hold(self) -> None:
        """Answer with where the arm is, or with where its session began once it is guided.

        Where it is *now* would make it creep while it is guided: it always lags a little.
        """
        packet = self.watch.packet
        if packet is not None and self._seed is not None:
            self.answer(self._seed, None)

    def readiness(self) -> str | None:
        """What is missing before a motion, in words; None if nothing is."""
        return self.watch.readiness() or self.unsendable

    def _waiting(self) -> Iterator[Datagram]:
        """What has come. After a hold-up that is more than is taken at once, and the rest of it
        is no cycle of its own: each answer but one would stay in the controller's queue."""
        for _ in range(_MOST_DRAINS):
            datagrams = self.link.drain()
            yield from datagrams
            if len(datagrams) < DRAINED_AT_ONCE:
                return
            if datagrams[-1].read_ns - datagrams[-1].arrival_ns < _OLD_NS:
                return

    def _decode(self, datagram: Datagram) -> Received | None:
        """The packet in a datagram of the controller; whose it is is looked at first."""
        host = datagram.sender[0]
        if self._controller is not None and host != self._controller:
            self.watch.note_unusable(
                f"datagrams come from {host}, and the controller is {self._controller} "
                "(--egm-controller)",
                datagram.arrival_ns,
            )
            return None
        try:
            packet = decode_feedback(datagram.data)
        except MalformedPacketError as error:
            self.watch.note_unusable(f"not a packet of a YuMi: {error}", datagram.arrival_ns)
            return None
        if self._controller is None and packet.clock_us is not None:
            self._controller = host
        return Received(packet, datagram.sender, datagram.arrival_ns, datagram.read_ns)
