"""The emulated controller's real time: one cycle after the other, 4.032 ms apart."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

MAX_BACKLOG_NS = 4_000_000
"""A controller that is kept from its work for longer than this lets the cycles be, instead of
rushing after them: a real one is never late. A rush would make chunks late that were planned in the
meantime; time that stands still for a moment does no harm."""


class Cycled(Protocol):
    """What has cycles, and something to do between them."""

    def cycle(self, now_ns: int) -> None:
        """One cycle."""

    def carry(self, now_ns: int) -> None:
        """What is due between two cycles."""

    @property
    def next_due_ns(self) -> int | None:
        """When `carry` has something to do; None if it has not."""


class RealTimePace:
    """Runs cycles by the monotonic clock.

    Args:
        period_ns: Of a cycle.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self.slips = 0
        """How often cycles were left out because this process came too late."""

    def run(self, controller: Cycled, go_on: Callable[[], bool]) -> None:
        """Run while `go_on` says so; it is asked before each cycle."""
        due_ns = time.monotonic_ns()
        while go_on():
            controller.cycle(time.monotonic_ns())
            due_ns += self._period_ns
            behind_ns = time.monotonic_ns() - due_ns
            if behind_ns > MAX_BACKLOG_NS:
                self.slips += 1
                due_ns += behind_ns
            self._wait(controller, due_ns)

    def _wait(self, controller: Cycled, due_ns: int) -> None:
        while (now_ns := time.monotonic_ns()) < due_ns:
            until_ns = min(due_ns, controller.next_due_ns or due_ns)
            if until_ns > now_ns:
                time.sleep((until_ns - now_ns) / 1e9)
            if until_ns < due_ns:
                controller.carry(time.monotonic_ns())
