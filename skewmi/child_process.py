"""A process that works beside its owner: started with a task, told lines, asked why it ended.

Its owner works on without waiting for it, until it asks for the end. It outlives whoever started
it: if that is killed, its end of the child's standard input closes, and the child finishes. What
such a child does at its end is in `child`.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Self, TypeVar

from skewmi.child import child_command, told, wait_for_line

T = TypeVar("T")

_LAST_WORDS_S = 0.5
"""A child that is not ready and has said why is about to end; otherwise it hangs."""
WORK_S = 0.05
"""Processor time that is work, and not the timers of a library in a process that hangs."""


class ChildStartError(Exception):
    """The process did not get ready; the message says why."""


class ChildProcess:
    """A child process that runs one of our modules; `launch` makes one.

    Args:
        process: The child.
        words: Where its standard error goes.
    """

    def __init__(self, process: subprocess.Popen[bytes], words: IO[bytes]) -> None:
        self.process = process
        self._words = words
        self._worked_s = 0.0

    @classmethod
    def launch(cls, module: str, task: object, timeout_s: float) -> Self:
        """Start a module and give it a task; returns once it has told that it is ready.

        Args:
            module: What to run, as `python -m`.
            task: What it is told first; JSON.
            timeout_s: How long it may take to get ready, s.

        Raises:
            ChildStartError: It ended, or was not ready in time.
        """
        # A file, because nobody reads while it runs: a full pipe would block it.
        words = TemporaryFile()  # noqa: SIM115 (lives as long as the child)
        process = subprocess.Popen(
            child_command("-m", module),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=words,
            # A session of its own, so that Ctrl-C reaches the owner only, who then ends the child.
            start_new_session=True,
        )
        child = cls(process, words)
        child.write(task)
        assert process.stdout is not None
        if wait_for_line(process.stdout, _is_ready, timeout_s) is None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_LAST_WORDS_S)
            process.kill()
            raise ChildStartError(child.reason())
        return child

    def write(self, content: object) -> None:
        """Send a line; not for the hot loop. Nothing happens if the process is gone."""
        assert self.process.stdin is not None
        with contextlib.suppress(OSError, ValueError):
            self.process.stdin.write(json.dumps(content).encode() + b"\n")
            self.process.stdin.flush()

    def let_finish(self) -> None:
        """Close the child's standard input: that is how it learns that this was all."""
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):
            self.process.stdin.close()

    def is_working(self) -> bool:
        """Whether the process has used the processor, by `WORK_S`, since this was asked last.

        One that hangs has not; one that a busy computer leaves little time has. False where the
        system does not tell (it does in `/proc` on Linux).
        """
        before, self._worked_s = self._worked_s, _processor_s(self.process.pid)
        return self._worked_s >= before + WORK_S

    def wait(self, idle_s: float, longest_s: float) -> int | None:
        """Wait for the end of the process for as long as it works.

        Args:
            idle_s: For how long it may do nothing, s.
            longest_s: How long to wait at most, s.

        Returns:
            Its exit code; None if it has not ended.
        """
        try:
            return self._while_working(self.process.wait, idle_s, longest_s)
        except subprocess.TimeoutExpired:
            return None

    def _while_working(self, attempt: Callable[[float], T], idle_s: float, longest_s: float) -> T:
        """Wait by `attempt` again and again for as long as the process works.

        Args:
            attempt: Waits for so many s; raises `subprocess.TimeoutExpired`.
            idle_s, longest_s: See `wait`.

        Raises:
            subprocess.TimeoutExpired: It hangs, or has worked for too long.
        """
        self.is_working()
        until = time.monotonic() + longest_s
        while True:
            try:
                return attempt(idle_s)
            except subprocess.TimeoutExpired:
                if not self.is_working() or time.monotonic() > until:
                    raise

    def reason(self) -> str:
        """Why the process ended, in its own words if it had any; waits for the end."""
        self.process.wait()
        self._words.seek(0)
        lines = [s for s in self._words.read().decode(errors="replace").splitlines() if s.strip()]
        return lines[-1] if lines else "its process was killed or hung"


def _processor_s(pid: int) -> float:
    """What a process has used of the processor, s; 0 where the system does not tell."""
    try:
        # The name in brackets may contain anything; behind it, user and system time are 12th, 13th.
        told_of = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
        ticks = sum(map(int, told_of.rpartition(")")[2].split()[11:13]))
        return ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError):
        return 0.0


def _is_ready(line: bytes) -> bool:
    return told(line) == {"ready": True}
