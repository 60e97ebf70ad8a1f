"""How time passes for robots that have no clock of their own: in real time, or in lock-step."""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import Enum
from typing import Protocol

from skewmi.trajectory import CYCLE_NS

MAX_BACKLOG_NS = 20_000_000
"""A real-time clock that falls behind by more than this slips instead of rushing after it:
a rush would make every chunk late that was planned in the meantime."""

_REPEAT_NS = 50_000_000
_IDLE_SLEEP_S = 30e-6
_IDLE_NS = 5_000_000
"""Who has waited for so long waits more calmly: on a busy computer, looking again and again takes
the time from the one that is waited for."""
_CALM_SLEEP_S = 500e-6


class Beat(Enum):
    """What a wait has come to."""

    NEXT = "next"
    """The next cycle begins."""
    AGAIN = "again"
    """Time stands still; the state is told again, for those who come late."""
    NONE = "none"
    """Nothing yet."""


class Pace(Protocol):
    """When cycles begin."""

    slips: int
    """How often cycles were left out because the caller came too late."""

    def wait(self) -> Beat:
        """Wait for the next cycle, a few milliseconds at most."""

    def due(self) -> bool:
        """Whether it need not be waited for any more."""


class RealTimePace:
    """Cycles by the monotonic clock. The first two begin at once: in between, a server gets ready.

    Args:
        period_ns: Between two cycles.
    """

    def __init__(self, period_ns: int) -> None:
        self.slips = 0
        self._period_ns = period_ns
        self._starts = 2
        self._due_ns = 0

    def wait(self) -> Beat:
        """Sleep until the next cycle is due."""
        now_ns = time.monotonic_ns()
        if self._starts:
            self._starts -= 1
            self._due_ns = now_ns
        behind_ns = now_ns - self._due_ns
        if behind_ns > MAX_BACKLOG_NS:
            self.slips += 1
            self._due_ns = now_ns
        elif behind_ns < 0:
            time.sleep(-behind_ns / 1e9)
        self._due_ns += self._period_ns
        return Beat.NEXT

    def due(self) -> bool:
        """By the monotonic clock."""
        return time.monotonic_ns() >= self._due_ns


class LockStepPace:
    """As fast as both sides can: time moves on by `CYCLE_NS` once it may.

    Args:
        period_ns: Between two cycles.
        may_advance: Asked after every `CYCLE_NS`, where states are published.
    """

    def __init__(self, period_ns: int, may_advance: Callable[[], bool]) -> None:
        self.slips = 0
        self._period_ns = period_ns
        self._may_advance = may_advance
        self._time_ns = -period_ns
        self._told_ns = 0

    def wait(self) -> Beat:
        """Never longer than a moment; at the end of a stretch nothing happens until it may."""
        stands = self._time_ns >= 0 and self._time_ns % CYCLE_NS < self._period_ns
        if not stands or self._may_advance():
            self._time_ns += self._period_ns
            self._told_ns = time.monotonic_ns()
            return Beat.NEXT
        now_ns = time.monotonic_ns()
        if now_ns - self._told_ns >= _REPEAT_NS:
            self._told_ns = now_ns
            return Beat.AGAIN
        time.sleep(_IDLE_SLEEP_S if now_ns - self._told_ns < _IDLE_NS else _CALM_SLEEP_S)
        return Beat.NONE

    def due(self) -> bool:
        """Never: time waits for whatever is to be done."""
        return False


def make_pace(period_ns: int, may_advance: Callable[[], bool], *, lock_step: bool) -> Pace:
    """The pace of a robot that has no clock of its own."""
    return LockStepPace(period_ns, may_advance) if lock_step else RealTimePace(period_ns)
