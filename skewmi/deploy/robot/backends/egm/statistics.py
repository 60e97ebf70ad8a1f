"""How well a link to a controller works: counted and averaged, never in the way of a reply."""

from __future__ import annotations

from dataclasses import dataclass

LATE_NS = 2_000_000
"""A reply that takes longer than this, half a cycle, is late."""

_SMOOTHING = 1.0 / 16.0
"""Of the running averages, as RFC 3550 has it for jitter."""


@dataclass
class LinkStatistics:
    """Of the present session.

    Attributes:
        packets: Accepted ones.
        missed: Cycles whose packet never came.
        ignored: Duplicates and overtaken ones.
        replies: References sent.
        late: Those that took longer than `LATE_NS` from the packet's arrival.
        unsent: References that the system's socket did not take.
        interval_ns: Running mean of the time between packets, per cycle; 0 until known.
        jitter_ns: Running mean of how far arrivals differ from the packets' own time.
        reply_ns: Running mean of the time from a packet's arrival to its reply.
    """

    packets: int = 0
    missed: int = 0
    ignored: int = 0
    replies: int = 0
    late: int = 0
    unsent: int = 0
    interval_ns: float = 0.0
    jitter_ns: float = 0.0
    reply_ns: float = 0.0

    def note_packet(self, ticks: int, elapsed_ns: float, clock_elapsed_ns: float) -> None:
        """Count a packet that came `ticks` cycles after the one before it.

        Args:
            ticks: At least 1.
            elapsed_ns: Between the arrivals.
            clock_elapsed_ns: Between the packets, by their own time.
        """
        self.packets += 1
        self.missed += ticks - 1
        per_tick_ns = elapsed_ns / ticks
        if self.interval_ns == 0.0:
            self.interval_ns = per_tick_ns
        self.interval_ns += _SMOOTHING * (per_tick_ns - self.interval_ns)
        difference_ns = abs(elapsed_ns - clock_elapsed_ns)
        self.jitter_ns += _SMOOTHING * (difference_ns - self.jitter_ns)

    def note_reply(self, taken_ns: float) -> None:
        """Count a reply that was sent so long after its packet arrived."""
        self.replies += 1
        self.late += taken_ns > LATE_NS
        self.reply_ns += _SMOOTHING * (taken_ns - self.reply_ns)

    @property
    def rate_hz(self) -> float:
        """Cycles a second; 0 until known."""
        return 1e9 / self.interval_ns if self.interval_ns else 0.0

    @property
    def late_fraction(self) -> float:
        """Of the replies."""
        return self.late / self.replies if self.replies else 0.0
