"""What a command that takes a while shows meanwhile: one helper for all of them.

For people, on a terminal, a bar: what is done, how far it is, how long it will take, and a few
words. It fits into any width, the words giving way first. Elsewhere, in a file or a pipe, a line
every `EVERY_S` seconds. All of it goes to standard error.
"""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import Self, TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn
from rich.table import Column

EVERY_S = 30.0
"""Between two lines where there is no terminal, s."""
LINE_S = 0.5
"""Between two looks at what a live line says, s."""
_BAR_WIDTH = 18


class ProgressBar:
    """A bar, or lines; a context manager.

    Args:
        what: That is going on, such as "drawing".
        unit: Of what is counted, for people; empty for none.
        enabled: Whether to show anything.
        transient: Whether the bar vanishes at the end.
        console: Where; standard error if not given.
        clock: Seconds.
    """

    def __init__(
        self,
        what: str,
        unit: str = "",
        *,
        enabled: bool = True,
        transient: bool = True,
        console: Console | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._what, self._unit, self._clock = what, unit, clock
        self._console = Console(file=sys.stderr) if console is None else console
        self._enabled = enabled
        self._lines = enabled and not self._console.is_terminal
        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}", table_column=Column(no_wrap=True)),
            BarColumn(bar_width=_BAR_WIDTH),
            TextColumn("{task.fields[count]}", table_column=Column(no_wrap=True)),
            TextColumn(
                "{task.fields[words]}",
                table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1),
                markup=False,
            ),
            console=self._console,
            transient=transient,
            disable=not enabled or self._lines,
            expand=True,
        )
        self._task = self._progress.add_task(what, total=None, count="", words="")
        self._begun = self._told = self._clock()

    def __enter__(self) -> Self:
        self._begun = self._told = self._clock()
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._progress.stop()

    def __call__(
        self, done: float, total: float | None, words: str = "", left_s: float | None = None
    ) -> None:
        """Say how far it is.

        Args:
            done: Of `total`.
            total: None if nobody knows.
            words: What else is worth knowing.
            left_s: How long it will take, s, if that is known better than by what was done so far.
        """
        if not self._enabled:
            return
        now = self._clock()
        if left_s is None and total is not None and done > 0.0:
            left_s = (now - self._begun) * max(total - done, 0.0) / done
        count = count_text(done, total, self._unit, left_s)
        if not self._lines:
            self._progress.update(self._task, completed=done, total=total, count=count, words=words)
        elif now - self._told >= EVERY_S:
            self._told = now
            self._tell(": ".join((self._what, "  ".join(filter(None, (count, words))))))

    def note(self, text: str) -> None:
        """A line that stays, above the bar."""
        if self._enabled:
            self._tell(text)

    def _tell(self, text: str) -> None:
        self._progress.console.print(text, highlight=False, markup=False, soft_wrap=True)


class LiveLine:
    """A line that says what is going on now, rewritten in place; a context manager.

    A thread of its own asks for it twice a second and writes it with a single call: who is asked
    about moves an arm, and must not wait for a terminal. Elsewhere than on a terminal it is a line
    every `EVERY_S` seconds.

    Args:
        words: What to say; nothing is said while it is empty. Called from that thread.
        file: Where; standard error if not given.
        clock: Seconds.
    """

    def __init__(
        self,
        words: Callable[[], str],
        *,
        file: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._words, self._clock = words, clock
        self._file = sys.stderr if file is None else file
        self._terminal = self._file.isatty()
        self._end, self._lock = threading.Event(), threading.Lock()
        self._shown = False
        self._told = clock()
        self._thread = threading.Thread(target=self._keep_saying, name="skewmi-line", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end.set()
        self._thread.join(1.0)
        with self._lock:
            self._write("")

    def note(self, text: str) -> None:
        """A line that stays."""
        with self._lock:
            self._write(f"{text}\n")

    def say(self) -> None:
        """Say it now, if it is time to."""
        words = self._words()
        with self._lock:
            if self._terminal and words:
                width = shutil.get_terminal_size().columns - 1
                self._write(words[:width])
                self._shown = True
            elif words and self._clock() - self._told >= EVERY_S:
                self._told = self._clock()
                self._write(f"{words}\n")

    def _keep_saying(self) -> None:
        while not self._end.wait(LINE_S):
            self.say()

    def _write(self, text: str) -> None:
        """In place of the line that is shown."""
        clear = "\r\x1b[K" if self._shown else ""
        self._shown = False
        if clear or text:
            with suppress(OSError, ValueError):  # The terminal may be gone; the arm comes first.
                self._file.write(clear + text)
                self._file.flush()


def count_text(done: float, total: float | None, unit: str, left_s: float | None) -> str:
    """Such as "120 of 500 frames, 1:05 left"."""
    digits = 0 if total is None or total >= 20 else 1
    whole = float(done).is_integer() and (total is None or float(total).is_integer())
    number = f"{done:,.0f}" if whole else f"{done:,.{digits}f}"
    if total is not None:
        number += f" of {total:,.0f}" if whole else f" of {total:,.{digits}f}"
    number += f" {unit}" if unit else ""
    return number if left_s is None else f"{number}, {time_text(left_s)} left"


def time_text(seconds: float) -> str:
    """Such as 0:07, 12:30 or 3:05:00."""
    whole = round(max(seconds, 0.0))
    hours, rest = divmod(whole, 3600)
    minutes, rest = divmod(rest, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


@contextmanager
def progress(what: str, unit: str = "", *, enabled: bool = True) -> Iterator[ProgressBar]:
    """A bar that vanishes at the end; call it with (done, total, words)."""
    with ProgressBar(what, unit, enabled=enabled) as bar:
        yield bar
