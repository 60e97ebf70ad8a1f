"""What a sweep shows while it works: one line per run, with its progress and the time left."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from types import TracebackType

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from skewmi.sweep.driver import State, Tracked
from skewmi.sweep.estimate import Estimate, in_words

EVERY_S = 60.0
"""Between two lines of a run where there is no terminal."""
_REDRAW_S = 1.0


class SweepLines:
    """On a terminal the running runs are redrawn in place, below those that ended.

    Args:
        slots: How many work at the same time.
        quiet: Show nothing.
    """

    def __init__(self, slots: Callable[[], int], *, quiet: bool) -> None:
        self._slots = slots
        self._console = Console(file=sys.stderr, quiet=quiet, highlight=False)
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._terminal = self._console.is_terminal and not quiet
        self._drawn = -EVERY_S

    def __enter__(self) -> SweepLines:
        if self._terminal:
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._terminal:
            self._live.stop()

    def happened(self, tracked: Tracked, word: str) -> None:
        """A line about something that has happened to a run."""
        why = f": {tracked.why}" if tracked.why else ""
        steps = f"{tracked.progress.steps:,} of {tracked.total_steps:,} steps"
        took = f" in {in_words(tracked.progress.seconds)}" if tracked.progress.seconds else ""
        self._console.print(f"{word:<7}  {tracked.run.name}  {steps}{took}{why}", soft_wrap=True)

    def draw(self, runs: Sequence[Tracked]) -> None:
        """Say how far all are, now and then."""
        now = time.monotonic()
        if now - self._drawn < (_REDRAW_S if self._terminal else EVERY_S):
            return
        self._drawn = now
        estimate = Estimate(runs)
        lines = [line(t, estimate) for t in runs if t.state is State.RUNNING]
        lines.append(summary(runs, estimate, self._slots()))
        if self._terminal:
            self._live.update(Group(*(Text(text, no_wrap=True) for text in lines)), refresh=True)
        else:
            for text in lines:
                self._console.print(text, soft_wrap=True)


def line(tracked: Tracked, estimate: Estimate) -> str:
    """A run that goes on."""
    share = tracked.progress.steps / tracked.total_steps
    filled = round(20 * min(share, 1.0))
    bar = "#" * filled + "." * (20 - filled)
    left = in_words(estimate.left(tracked))
    return f"{bar} {share:4.0%}  {tracked.run.name}  {tracked.progress.steps:,} steps, {left} left"


def summary(runs: Sequence[Tracked], estimate: Estimate, slots: int) -> str:
    """All of them."""
    count = {state: sum(t.state is state for t in runs) for state in State}
    words = [f"{number} {state.value}" for state, number in count.items() if number]
    return f"{len(runs)} runs: {', '.join(words)}; {in_words(estimate.in_all(slots))} left"
