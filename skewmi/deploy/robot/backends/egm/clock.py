"""The controller's clock, read from its packets: when a cycle was, and how long cycles are."""

from __future__ import annotations

NOMINAL_PERIOD_NS = 4_032_000.0
"""One cycle of a real controller, ns; a virtual one has about 4 ms."""

SHORTEST_PERIOD_NS = 1e6
LONGEST_PERIOD_NS = 50e6
"""Cycles outside of these are taken for errors of the packets' time, ns."""

_POSITION_GAIN = 0.05
_PERIOD_GAIN = 0.001
"""Of the loop that follows the packets' time. It settles within some 50 cycles, well damped:
0.05 / (2 sqrt(0.001)) = 0.8."""

_CLOCK_SET_NS = 20e6
"""A packet's time this far off the cycles counted means that somebody set the controller's clock,
or that the first guess of the period was wrong."""


class ControllerClock:
    """Time by counted cycles, held to the packets' own time by a phase-locked loop.

    The packets' time alone would not do: it has the jitter of whoever writes it, and somebody may
    set it. Cycles alone would not do either: nobody promises 4.032 ms. The result never goes back.

    Args:
        start_ns: What the clock shows at the first packet.
    """

    def __init__(self, start_ns: int) -> None:
        self.time_ns = float(start_ns)
        """When the newest packet's cycle was."""
        self.period_ns = NOMINAL_PERIOD_NS
        """How long a cycle takes."""
        self._offset_ns: float | None = None
        self._measured = False

    def begin(self, clock_us: int, elapsed_ns: int) -> None:
        """A session begins with a packet.

        Args:
            clock_us: The packet's time.
            elapsed_ns: Since the last packet, by our own clock; 0 at the first.
        """
        self.time_ns += max(elapsed_ns, 0)
        self._offset_ns = self.time_ns - clock_us * 1000.0

    def advance(self, ticks: int, clock_us: int) -> None:
        """Another packet of the session came, so many cycles after the last.

        Args:
            ticks: At least 1.
            clock_us: The packet's time.
        """
        assert self._offset_ns is not None, "begin comes first"
        told_ns = clock_us * 1000.0 + self._offset_ns
        if not self._measured:
            # 8 ms and more are possible settings: two packets tell them from the usual 4 ms.
            self._measured = True
            period_ns = (told_ns - self.time_ns) / ticks
            if 1.5 * NOMINAL_PERIOD_NS < period_ns <= LONGEST_PERIOD_NS:
                self.period_ns = period_ns
        expected_ns = self.time_ns + ticks * self.period_ns
        error_ns = told_ns - expected_ns
        if abs(error_ns) > _CLOCK_SET_NS:
            self._offset_ns -= error_ns
            error_ns = 0.0
        self.period_ns += _PERIOD_GAIN * error_ns / ticks
        self.period_ns = min(max(self.period_ns, SHORTEST_PERIOD_NS), LONGEST_PERIOD_NS)
        step_ns = ticks * self.period_ns + _POSITION_GAIN * error_ns
        self.time_ns += max(step_ns, 0.5 * ticks * self.period_ns)
