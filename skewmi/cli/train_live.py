"""Shows a training while it goes on, or a past one, from its run directory.

The view is a process of its own that reads the run's files: the training sends it nothing and waits
for nothing, so that whatever becomes of the view or of a viewer, the training goes on as without.
"""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Self

from skewmi.child_process import ChildProcess
from skewmi.deploy.replay.live_child import HUNG, DrawnByChild, places, starting
from skewmi.deploy.replay.live_options import LiveOptions

MODULE = "skewmi.cli.train_live_process"
_START_TIMEOUT_S = 60.0
_CLOSE_TIMEOUT_S = 10.0
"""For how long a view that is to end may do nothing."""
_CLOSE_LONGEST_S = 120.0


class LiveTraining(DrawnByChild[ChildProcess]):
    """A view of a training; a context manager that ends it; `start` makes one.

    Args:
        child: Draws.
    """

    def __init__(self, child: ChildProcess) -> None:
        super().__init__(child)
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
        task = {"run_dir": str(run_dir.resolve()), **places(options, str(run_dir))}
        with starting():
            return cls(ChildProcess.launch(MODULE, task, _START_TIMEOUT_S))

    @property
    def process(self) -> subprocess.Popen[bytes]:
        """That draws."""
        return self._child.process

    def close(self) -> str:
        """Let the view show what is left, and end it; what it lacks, in words, empty if nothing.

        Safe to call twice; waits for as long as the view works, `_CLOSE_LONGEST_S` at most.
        """
        if self._note is None:
            self._child.let_finish()
            self._note = self._judge()
        return self._note

    def _judge(self) -> str:
        code = self._child.wait(_CLOSE_TIMEOUT_S, _CLOSE_LONGEST_S)
        if code is None:
            self.process.kill()
            self.process.wait()
            return HUNG
        return "" if code == 0 else self._ended_early()
