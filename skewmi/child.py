"""Helper processes: how each of ours is started, and which of its output is its own.

`python -m` puts the folder one stands in first on the import path, so that a user's `queue.py`
there would be imported in place of Python's. Children of ours look where their parent's packages
are installed and in the user's PYTHONPATH, nowhere else.

A library may print to standard output at any time. What a child tells its parent there is a line
that no library writes; everything else is passed over.
"""

from __future__ import annotations

import json
import os
import select
import sys
import time
from collections.abc import Callable
from typing import IO, Any

_MARK = "skewmi-child "


def child_command(*arguments: str) -> list[str]:
    """The command that runs this interpreter as a helper process.

    Args:
        *arguments: Of the interpreter, such as "-m", "skewmi.cli.main", "stop".
    """
    return [sys.executable, "-P", *arguments]


def tell_parent(**content: Any) -> None:
    """Write a line that `told` recognises, at once; for children.

    Raises:
        OSError: The parent is gone.
    """
    # In one call, since threads may tell at the same time; it begins with the end of a line,
    # because somebody else may have begun one.
    sys.stdout.flush()
    os.write(1, f"\n{_MARK}{json.dumps(content)}\n".encode())


def told(line: str | bytes) -> dict[str, Any] | None:
    """What a line of a child's output tells its parent; None if it is not one of ours."""
    text = line.decode(errors="replace") if isinstance(line, bytes) else line
    if not text.startswith(_MARK):
        return None
    try:
        content = json.loads(text.removeprefix(_MARK))
    except ValueError:
        return None
    return content if isinstance(content, dict) else None


def wait_for_line(
    output: IO[bytes], accepts: Callable[[bytes], bool], timeout_s: float
) -> bytes | None:
    """Read a child's output until a line is the one that is waited for.

    Whatever follows it in what was read is dropped: call this before the child has been told to
    say more.

    Args:
        output: The child's end of a pipe; nothing else may have read from it.
        accepts: Whether a line, without its end, is the one.
        timeout_s: How long to wait, s.

    Returns:
        The line, or None if the child closed its output or did not say it in time.
    """
    descriptor, deadline, rest = output.fileno(), time.monotonic() + timeout_s, b""
    while (remaining := deadline - time.monotonic()) > 0.0:
        ready, _, _ = select.select([descriptor], [], [], remaining)
        read = os.read(descriptor, 65536) if ready else b""
        if not read:
            return None
        *lines, rest = (rest + read).split(b"\n")
        for line in lines:
            if accepts(line):
                return line
    return None
