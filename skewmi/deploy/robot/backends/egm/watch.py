"""What the bridge knows of its controller: the newest packet, the session, what is missing.

One thread, one controller. Packets go in through `note`; what the rest asks for are the newest
packet's values, whether a session has begun, and what stands between here and a motion.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from skewmi.deploy.robot.backends.egm.clock import ControllerClock
from skewmi.deploy.robot.backends.egm.packets import FeedbackPacket
from skewmi.deploy.robot.backends.egm.session import (
    GAP_NS,
    Accepted,
    Ignored,
    Received,
    judge,
    not_guiding,
)
from skewmi.deploy.robot.backends.egm.states import EGM_TABLE, EgmEvent, EgmState
from skewmi.deploy.robot.backends.egm.statistics import LinkStatistics
from skewmi.deploy.state_machine import StateMachine, Transition

OVERLOAD_NS = 100_000_000
"""So long at more than 100 % utilisation is no peak: late or lost replies alone make peaks."""

_OVERLOAD_PERCENT = 100.0


class Noted(NamedTuple):
    """What became of a packet.

    `accepted` says whether it counts, and `begins` why a session begins with it, if one does.
    """

    accepted: bool
    begins: str = ""


class ControllerWatch:
    """Follows the packets of one controller.

    Args:
        ramp_ns: How long the program takes from the start of a session to full tracking.
        start_ns: What the clock shows at the first packet.
        on_transition: Called after every change of state.
    """

    def __init__(
        self,
        ramp_ns: int,
        start_ns: int,
        on_transition: Callable[[Transition[EgmState]], None] | None = None,
    ) -> None:
        self._ramp_ns = ramp_ns
        self.machine = StateMachine(EGM_TABLE, on_transition)
        self.clock = ControllerClock(start_ns)
        self.statistics = LinkStatistics()
        self.sessions = 0
        """How many sessions in which the arm was guided have begun."""
        self.unusable = 0
        """Datagrams that were of no use."""
        self.unusable_reason = ""
        """Why the newest of them was not."""
        self._newest: Received | None = None
        self._session_ns = 0.0
        self._overloaded_since_ns: float | None = None
        self._unusable_ns = 0
        self._expecting = False
        """Whether packets go on that are of a session that is over."""

    @property
    def state(self) -> EgmState:
        return self.machine.state

    @property
    def newest(self) -> Received | None:
        """The newest accepted packet, however old; None before the first."""
        return self._newest

    @property
    def packet(self) -> FeedbackPacket | None:
        """What it says."""
        return None if self._newest is None else self._newest.packet

    def note(self, received: Received) -> Noted:
        """Take a packet in; from the controller's address, oldest first."""
        verdict = judge(received, self._newest)
        gone = self.state in (EgmState.SILENT, EgmState.REFUSED) and not self._expecting
        if isinstance(verdict, Accepted) and gone and not verdict.begins:
            # Silence was noticed a moment after this packet had come, which says of none.
            verdict = Accepted(verdict.ticks, "packets come again")
        if isinstance(verdict, Ignored):
            if received.packet.clock_us is None:
                self.note_unusable(verdict.why, received.arrival_ns)
            else:
                self.statistics.ignored += 1
            return Noted(False)
        self._take(received, verdict)
        packet = received.packet
        self._note_utilization(packet)
        missing = not_guiding(packet)
        if missing is not None:
            self._fire(EgmEvent.NOT_GUIDED, missing)
        elif verdict.begins:
            self.sessions += 1
            self._fire(EgmEvent.SESSION, f"session {self.sessions}: {verdict.begins}")
        else:
            self._follow_session()
        return Noted(True, verdict.begins)

    def _take(self, received: Received, verdict: Accepted) -> None:
        packet, before = received.packet, self._newest
        assert packet.clock_us is not None
        elapsed_ns = 0 if before is None else received.arrival_ns - before.arrival_ns
        if verdict.begins:
            self.clock.begin(packet.clock_us, elapsed_ns)
            self.statistics = LinkStatistics(packets=1)
            self._session_ns = self.clock.time_ns
            self._expecting = False
            self._overloaded_since_ns = None
        else:
            assert before is not None
            assert before.packet.clock_us is not None
            self.clock.advance(verdict.ticks, packet.clock_us)
            by_clock_ns = 1000.0 * (packet.clock_us - before.packet.clock_us)
            self.statistics.note_packet(verdict.ticks, elapsed_ns, by_clock_ns)
        self._newest = received

    def _follow_session(self) -> None:
        if self.state is EgmState.RAMPING and self.ramp_left_ns <= 0.0:
            self._fire(EgmEvent.RAMPED, f"full tracking {self._ramp_ns / 1e9:g} s after the start")
        since_ns = self._overloaded_since_ns
        if since_ns is None:
            self._fire(EgmEvent.RELIEF, "utilisation is at most 100 % again")
        elif self.clock.time_ns - since_ns >= OVERLOAD_NS:
            self._fire(
                EgmEvent.OVERLOAD,
                f"utilisation beyond {_OVERLOAD_PERCENT:g} % for {OVERLOAD_NS / 1e9:g} s: the "
                "controller follows references in part",
            )

    @property
    def ramp_left_ns(self) -> float:
        """Until the controller tracks fully; negative once it does."""
        return self._session_ns + self._ramp_ns - self.clock.time_ns

    def _note_utilization(self, packet: FeedbackPacket) -> None:
        if packet.utilization is None or packet.utilization <= _OVERLOAD_PERCENT:
            self._overloaded_since_ns = None
        elif self._overloaded_since_ns is None:
            self._overloaded_since_ns = self.clock.time_ns

    def note_unusable(self, reason: str, now_ns: int) -> None:
        """Count a datagram that is no packet of the controller."""
        self.unusable += 1
        self.unusable_reason = reason
        self._unusable_ns = now_ns
        if self.state is EgmState.SILENT:
            self._fire(EgmEvent.UNUSABLE, reason)

    def note_time(self, now_ns: int) -> None:
        """Nothing has come until now: silence is noticed here."""
        last_ns = self._unusable_ns
        if self.state is not EgmState.REFUSED and self._newest is not None:
            last_ns = self._newest.arrival_ns
        if now_ns - last_ns >= GAP_NS:
            self._fire(EgmEvent.SILENCE, f"no packet from the controller for {GAP_NS / 1e9:g} s")
            if self.unusable and now_ns - self._unusable_ns < GAP_NS:
                # Datagrams do come; what is wrong with them says more than that none is accepted.
                self._fire(EgmEvent.UNUSABLE, self.unusable_reason)

    def expect_session(self, reason: str) -> None:
        """The present session is over, whatever its last packets say; a new one is to begin."""
        self._expecting = True
        self._fire(EgmEvent.SILENCE, reason)

    def readiness(self) -> str | None:
        """What is missing before a motion, the first of: packets, version, motors, program, EGM,
        ramp, utilisation. None if nothing is."""
        if self.state is EgmState.GUIDING:
            return None
        if self.state is EgmState.REFUSED:
            return self.unusable_reason
        if self._newest is None:
            return (
                "no packet from a controller yet; it sends them once its program has come to "
                "EGMActJoint, to the address in its UdpUc device"
            )
        if self.state is EgmState.FOLLOWING:
            return not_guiding(self._newest.packet)
        if self.state is EgmState.RAMPING:
            left_s = max(self.ramp_left_ns, 0.0) / 1e9
            return f"the session is {left_s:.2g} s short of full tracking (ramp-in)"
        return self.machine.reason

    def _fire(self, event: EgmEvent, reason: str) -> None:
        self.machine.fire(event, reason, int(self.clock.time_ns))
