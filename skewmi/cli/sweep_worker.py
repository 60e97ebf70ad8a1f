"""The worker of a sweep: `python -m skewmi.cli.sweep_worker RUN_FOLDER`.

It ends with the process that started it, which holds the other end of standard input.
"""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path

from skewmi.matrix_kernels import take_fast_kernels

_ORPHANED = 74


def end_with_parent() -> None:
    """End this process when whoever started it is gone; checkpoints are whole at any moment."""

    def watch() -> None:
        # Not through sys.stdin: its lock would be asked for when the interpreter ends.
        while os.read(0, 4096):
            pass
        os._exit(_ORPHANED)

    threading.Thread(target=watch, daemon=True).start()


def main() -> int:
    """Train the run that the command line names. Returns the exit code."""
    end_with_parent()
    take_fast_kernels()
    from skewmi.cli.sweep_run import work  # imports torch

    return work(Path(sys.argv[1]))


if __name__ == "__main__":
    sys.exit(main())
