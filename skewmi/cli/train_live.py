"""Shows a training while it goes on, or a past one, from its run directory.

The view is a process of its own that reads the run's files: the training sends it nothing and waits
for nothing, so that whatever becomes of the view or of a viewer, the training goes on as without.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
from pathlib import Path
from tempfile import TemporaryFile
from types import TracebackType
from typing import IO, Any, Self

from skewmi.child import child_command, told, wait_for_line
from skewmi.deploy.replay.live_options import LiveOptions
from skewmi.errors import ConfigurationError

MODULE = "skewmi.cli.train_live_process"
_START_TIMEOUT_S = 60.0
_CLOSE_TIMEOUT_S = 10.0


class LiveTraining:
    """A view of a training; a context manager that ends it; `start` makes one.

    Args:
        process: Draws.
        words: Where its standard error goes.
    """

    def __init__(self, process: subprocess.Popen[bytes], words: IO[bytes]) -> None:
        self.process = process
        self._words = words
        self._note: str | None = None

    @classmethod
    def start(cls, options: LiveOptions, run_dir: Path) -> Self:
        """Open a view of a run that is about to begin or go on.

        Args:
            options: Where to show it.
            run_dir: Of the run; may not exist yet.

        Raises:
            ConfigurationError: It cannot be shown there.
        """
        # A file, because nobody reads while it runs: a full pipe would block it.
        words = TemporaryFile()  # noqa: SIM115 (lives as long as the view)
        process = subprocess.Popen(
            child_command("-m", MODULE),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=words,
            # Ctrl-C ends the training, which then ends the view.
            start_new_session=True,
        )
        view = cls(process, words)
        assert process.stdin is not None
        assert process.stdout is not None
        with contextlib.suppress(OSError):
            process.stdin.write(json.dumps(_task(options, run_dir)).encode() + b"\n")
            process.stdin.flush()
        if wait_for_line(process.stdout, _is_ready, _START_TIMEOUT_S) is None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.5)
            process.kill()
            raise ConfigurationError(f"no live view: {view._reason()}")
        return view

    def close(self) -> str:
        """Let the view show what is left, and end it; what it lacks, in words, empty if nothing.

        Safe to call twice; waits for `_CLOSE_TIMEOUT_S` at most.
        """
        if self._note is None:
            assert self.process.stdin is not None
            with contextlib.suppress(OSError):
                self.process.stdin.close()
            self._note = self._judge()
        return self._note

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _judge(self) -> str:
        try:
            code = self.process.wait(_CLOSE_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            return "the live view hung and was ended"
        return "" if code == 0 else f"the live view ended early: {self._reason()}"

    def _reason(self) -> str:
        self.process.wait()
        self._words.seek(0)
        lines = [s for s in self._words.read().decode(errors="replace").splitlines() if s.strip()]
        return lines[-1] if lines else "its process was killed or hung"


def _task(options: LiveOptions, run_dir: Path) -> dict[str, Any]:
    return {
        "run_dir": str(run_dir.resolve()),
        "title": str(run_dir),
        "spawn": options.spawn and options.web_ports is None,
        "web": options.web_ports,
        "connect": options.connect,
        "out": None if options.out is None else str(options.out),
    }


def _is_ready(line: bytes) -> bool:
    return told(line) == {"ready": True}
