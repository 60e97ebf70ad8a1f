"""How long runs will still take, from how long those like them took."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

from skewmi.sweep.driver import State, Tracked


def kind(tracked: Tracked) -> Hashable:
    """Runs of the same kind take about the same time a step."""
    config = tracked.run.config
    return config.task, config.preset, config.learner, config.exploration


class Estimate:
    """Seconds per step, by kind of run.

    Args:
        runs: All of a sweep.
    """

    def __init__(self, runs: Sequence[Tracked]) -> None:
        self.runs = runs
        known: dict[Hashable, list[float]] = {}
        for tracked in runs:
            if tracked.progress.steps and tracked.progress.seconds:
                rate = tracked.progress.seconds / tracked.progress.steps
                known.setdefault(kind(tracked), []).append(rate)
        self._rates = {key: sum(rates) / len(rates) for key, rates in known.items()}

    def left(self, tracked: Tracked) -> float | None:
        """Seconds until a run has all its steps, at most; None: nothing like it has begun."""
        if tracked.state in (State.DONE, State.FAILED):
            return 0.0
        steps = tracked.progress.steps
        own = tracked.progress.seconds / steps if steps else None
        rate = own or self._rates.get(kind(tracked))
        return None if rate is None else rate * max(tracked.total_steps - steps, 0)

    def in_all(self, slots: int) -> float | None:
        """Seconds until all are done, if so many work at the same time; None: unknown.

        Kinds that nothing is known of count like the mean of the others.
        """
        left = [self.left(tracked) for tracked in self.runs]
        if not self._rates:
            return None
        mean = sum(self._rates.values()) / len(self._rates)
        seconds = [
            mean * tracked.total_steps if value is None else value
            for tracked, value in zip(self.runs, left, strict=True)
        ]
        return max(sum(seconds) / max(slots, 1), max(seconds, default=0.0))


def in_words(seconds: float | None) -> str:
    """A duration as people say it."""
    if seconds is None:
        return "unknown"
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    if seconds < 5400.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"
