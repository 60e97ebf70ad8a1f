"""Rerun files that are whole, or an error.

Where Rerun writes a file itself, it does so in a thread of its own. What fails there it tells its
log; whoever drew learns it from `flush` at best, and never of what fails last, when `disconnect`
writes the end of the file. At worst Rerun (0.41) waits for that dead thread for ever: in `flush`,
in `disconnect`, and when the process ends. So a file that need not grow meanwhile is written here,
and the end of the others is looked for.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from skewmi.errors import OutputError
from skewmi.outputs import cannot_write, written_aside

_PROBE_BYTES = 1 << 20
"""More than the rest of a disk on which Rerun could not write its last part, as a rule."""


@contextmanager
def drawn_into(stream: Any, path: Path) -> Iterator[None]:
    """While the block runs, what is drawn goes into a file, which takes its place when it is whole.

    Until then it is kept in memory, as it will be by the viewer that opens it.

    Args:
        stream: A `rerun.RecordingStream` without a sink.
        path: The file.

    Raises:
        OutputError: It cannot be written; what was there stays.
    """
    with written_aside(path) as draft:
        # Before any work is done for a file that cannot be.
        draft.touch()
        drawn = stream.memory_recording()
        try:
            yield
        except Exception:
            # Rerun would warn of what nobody took, beside the line that tells what happened.
            drawn.drain_as_bytes()
            raise
        with whole_at_end(draft, path):
            draft.write_bytes(drawn.drain_as_bytes())


@contextmanager
def whole_at_end(written: Path, path: Path) -> Iterator[None]:
    """In the block a file gets its end: make sure that it has.

    Args:
        written: The file that is written.
        path: What to call it.

    Raises:
        OutputError: It is not whole; the message says why, as far as that can be found.
    """
    with _refusals_told(written, path):
        yield
    if not is_whole(written):
        raise _refusal(written, path, "its end is missing")


def is_whole(path: Path) -> bool:
    """Whether a Rerun file has the end that Rerun writes last, and all that this tells of."""
    # Late, as everywhere: Rerun takes a while to import.
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        # A file without an end might be one of older versions; ours are not.
        warnings.simplefilter("ignore")
        try:
            RrdReader(path).store()
        except (RuntimeError, ValueError, OSError):
            return False
    return True


@contextmanager
def _refusals_told(written: Path, path: Path) -> Iterator[None]:
    try:
        yield
    except (RuntimeError, ValueError) as error:
        raise _refusal(written, path, " ".join(str(error).split())) from error


def _refusal(written: Path, path: Path, words: str) -> OutputError:
    """Why a file is not whole: what the system says to one who writes on, else Rerun's words."""
    try:
        size = written.stat().st_size
        try:
            with written.open("r+b") as file:
                file.seek(size)
                file.write(bytes(_PROBE_BYTES))
        finally:
            with written.open("r+b") as file:
                file.truncate(size)
    except OSError as reason:
        return cannot_write(path, reason)
    return OutputError(f"cannot write {path}: Rerun could not finish it ({words})")
