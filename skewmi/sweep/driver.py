"""The loop that gets every run of a sweep done, once, whatever dies meanwhile.

Which runs there are and which are done is in the sweep's folder alone, so that a driver can be
killed at any moment and another one takes over. That no run is trained twice at the same time is
not the driver's word but the lock of the run's folder (`train.lock`), which its worker takes.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from threading import Event

from skewmi.sweep.engine import BUSY, DONE, INVISIBLE, LOST, REFUSED, Engine, Job
from skewmi.sweep.places import LOG
from skewmi.sweep.plan import Run
from skewmi.sweep.run_folder import Progress, is_done, read_progress, write_run

ATTEMPTS = 3
"""Workers of a run that may be lost one after the other without a step of progress."""
POLL_S = 0.2
BUSY_S = 5.0
"""Before a run is tried again that another process trains."""


class State(Enum):
    """Of a run, in words."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


@dataclass
class Tracked:
    """A run, and what the driver knows of it.

    Attributes:
        run: Which.
        state: Now.
        progress: As far as it was last read.
        why: It failed or waits.
        lost: Workers in a row without progress.
        not_before: Monotonic clock, s.
        job: Its worker, while there is one.
    """

    run: Run
    state: State = State.WAITING
    progress: Progress = field(default_factory=Progress)
    why: str = ""
    lost: int = 0
    not_before: float = 0.0
    job: Job | None = None

    @property
    def total_steps(self) -> int:
        """Most steps that it will have."""
        return self.run.config.total_steps


Report = Callable[[Tracked, str], None]
"""Told of a run whenever something happens to it, with a word for what: `starts`, `goes on`,
`done`, `failed`, `lost`, `waits`."""


class Driver:
    """Runs to get done, and an engine that trains them.

    Args:
        runs: Each once.
        folder: Of the runs' folders.
        engine: Where they are trained.
        report: Told what happens.
    """

    def __init__(self, runs: tuple[Run, ...], folder: Path, engine: Engine, report: Report) -> None:
        self.folder, self.engine, self.report = folder, engine, report
        self.tracked = [Tracked(run) for run in runs]
        self.waiting = deque[Tracked]()
        self.running: list[Tracked] = []
        for tracked in self.tracked:
            tracked.progress = read_progress(self._place(tracked))
            if is_done(self._place(tracked)):
                tracked.state = State.DONE
            else:
                self.waiting.append(tracked)

    def run(self, stop: Event, each: Callable[[], None] = lambda: None) -> bool:
        """Work until nothing is left to do.

        Args:
            stop: Set to end early: workers are ended, and another call goes on.
            each: Called several times a second.

        Returns:
            Whether nothing was left to do.
        """
        try:
            while (self.waiting or self.running) and not stop.is_set():
                for tracked in list(self.running):
                    self._look_after(tracked)
                self._fill()
                each()
                stop.wait(POLL_S)
        finally:
            for tracked in self.running:
                if tracked.job is not None:
                    tracked.job.end()
        return not (self.waiting or self.running)

    def _place(self, tracked: Tracked) -> Path:
        return self.folder / tracked.run.name

    def _fill(self) -> None:
        """Start workers while there is room."""
        now = time.monotonic()
        for tracked in [t for t in self.waiting if t.not_before <= now]:
            if len(self.running) >= self.engine.slots():
                return
            self.waiting.remove(tracked)
            write_run(self._place(tracked), tracked.run.config)
            tracked.job = self.engine.start(self._place(tracked), tracked.run.config.threads)
            tracked.state, tracked.why = State.RUNNING, ""
            self.running.append(tracked)
            self.report(tracked, "goes on" if tracked.progress.steps else "starts")

    def _look_after(self, tracked: Tracked) -> None:
        assert tracked.job is not None
        code = tracked.job.poll()
        before, tracked.progress = tracked.progress, read_progress(self._place(tracked))
        if tracked.progress.steps > before.steps:
            tracked.lost = 0
        if code is None:
            return
        self.running.remove(tracked)
        tracked.job = None
        if code == DONE and is_done(self._place(tracked)):
            tracked.state = State.DONE
            self.report(tracked, "done")
        elif code == BUSY:
            tracked.why = "another process trains it"
            self._again(tracked, BUSY_S, "waits")
        elif code in (REFUSED, INVISIBLE):
            self._fail(tracked, self._last_words(tracked, code))
        else:
            self._lost(tracked, code)

    def _lost(self, tracked: Tracked, code: int) -> None:
        """A worker died; its run goes on from its checkpoint, unless that leads nowhere."""
        tracked.lost += 1
        how = {LOST: "with its machine", DONE: "without a result"}.get(
            code, f"of signal {-code}" if code < 0 else f"with exit code {code}"
        )
        if tracked.lost >= ATTEMPTS:
            words = self._last_words(tracked, code)
            self._fail(
                tracked, f"{ATTEMPTS} workers died {how} without a step of progress; {words}"
            )
        else:
            tracked.why = f"its worker died {how}"
            self._again(tracked, 0.0, "lost")

    def _again(self, tracked: Tracked, delay_s: float, word: str) -> None:
        tracked.state, tracked.not_before = State.WAITING, time.monotonic() + delay_s
        self.waiting.appendleft(tracked)
        self.report(tracked, word)

    def _fail(self, tracked: Tracked, why: str) -> None:
        tracked.state, tracked.why = State.FAILED, why
        self.report(tracked, "failed")

    def _last_words(self, tracked: Tracked, code: int) -> str:
        """What the worker said last."""
        log = self._place(tracked) / LOG
        if code == INVISIBLE:
            return (
                f"{self._place(tracked)} is not there on the machine that was to train it: the "
                "sweep's folder must be on a disk that all machines share, under one name"
            )
        try:
            lines = log.read_text(errors="replace").strip().splitlines()
        except OSError:
            lines = []
        return lines[-1] if lines else f"nothing in {log}"
