"""How far a deployment is, for whoever wants to show it while it runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from skewmi.deploy.report import RunProgress


class RunWatch:
    """Asks a run how far it is, while there is one; the run does not know who asks, nor waits."""

    def __init__(self) -> None:
        self._ask: Callable[[], RunProgress] | None = None
        self._over = False
        self._begun = time.monotonic()

    @contextmanager
    def on(self, ask: Callable[[], RunProgress]) -> Iterator[None]:
        """Ask this one while the block runs."""
        self._ask = ask
        try:
            yield
        finally:
            self._ask, self._over = None, True

    def words(self) -> str:
        """Such as "episode 2 of 3: running, step 57 of 200, 0 cycles missed"; empty at the end."""
        ask = self._ask
        if ask is None:
            waited = time.monotonic() - self._begun
            return "" if self._over else f"getting ready, {waited:.0f} s"
        now = ask()
        step = f", step {now.step} of {now.steps}" if now.step else ""
        return (
            f"episode {now.episode} of {now.episodes}: {now.state}{step}, "
            f"{now.missed_cycles} cycles missed"
        )
