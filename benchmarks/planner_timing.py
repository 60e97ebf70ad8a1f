"""Times of what a real-time loop does: stages, percentiles, cycles that came too late."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

Seconds = tuple[float, float]
"""Wall and processor time."""


def percentiles(seconds: list[Seconds]) -> dict[str, float]:
    """Wall time p50, p99, p99.9 and maximum, and processor time p50 if measured, in ms."""
    wall, cpu = 1e3 * np.array(seconds).T
    p50, p99, p999 = np.percentile(wall, [50, 99, 99.9])
    figures = {
        "p50_ms": round(float(p50), 4),
        "p99_ms": round(float(p99), 4),
        "p99_9_ms": round(float(p999), 4),
        "max_ms": round(float(wall.max()), 4),
    }
    return figures | ({"cpu_p50_ms": round(float(np.median(cpu)), 4)} if cpu.any() else {})


class StageTimes:
    """Seconds per stage and round; a stage that is entered several times a round is summed up."""

    def __init__(self) -> None:
        self.rounds: dict[str, list[Seconds]] = defaultdict(list)
        self._now: dict[str, list[float]] = {}

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        """Time the block."""
        cpu, wall = time.thread_time(), time.perf_counter()
        yield
        self._add(stage, time.perf_counter() - wall, time.thread_time() - cpu)

    def watch(self, owner: Any, method: str, stage: str) -> None:
        """From now on, time every call of a method of an object (less than 1 us each)."""
        function: Callable[..., Any] = getattr(owner, method)

        def timed(*args: Any, **kwargs: Any) -> Any:
            # Wall time only: reading the processor's takes longer than some of these calls.
            wall = time.perf_counter()
            result = function(*args, **kwargs)
            self._add(stage, time.perf_counter() - wall, 0.0)
            return result

        setattr(owner, method, timed)

    def end_round(self) -> None:
        """What was timed since the last call belongs to one round."""
        for stage, (wall, cpu) in self._now.items():
            self.rounds[stage].append((wall, cpu))
        self._now.clear()

    def figures(self) -> dict[str, dict[str, float]]:
        return {stage: percentiles(seconds) for stage, seconds in self.rounds.items()}

    def _add(self, stage: str, wall: float, cpu: float) -> None:
        total = self._now.setdefault(stage, [0.0, 0.0])
        total[0] += wall
        total[1] += cpu


class Pace:
    """A clock that ticks every `period` seconds of real time, and counts late work.

    Args:
        period: s.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._due = time.perf_counter()
        self.missed = 0
        """Rounds that were not done when the next one was due."""
        self.late: list[float] = []
        """How late each round began, s."""

    def wait(self) -> None:
        """Until the next round is due. One that is over already is skipped, not caught up."""
        now = time.perf_counter()
        if now < self._due:
            time.sleep(self._due - now)
            now = time.perf_counter()
        self.late.append(now - self._due)

    def done(self) -> None:
        """The round's work is done."""
        now, self._due = time.perf_counter(), self._due + self._period
        if now > self._due:
            skipped = int((now - self._due) / self._period) + 1
            self.missed += skipped
            self._due += skipped * self._period

    def figures(self) -> dict[str, float | int]:
        late = 1e3 * np.array(self.late)
        return {
            "rounds": len(self.late),
            "missed": self.missed,
            "wake_up_late_p99_9_ms": round(float(np.percentile(late, 99.9)), 4),
        }
