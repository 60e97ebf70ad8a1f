"""One training per run directory: two would write over each other's checkpoints."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from skewmi.errors import ConfigurationError
from skewmi.outputs import make_folder, writing


class BusyError(ConfigurationError):
    """Another process trains in the directory."""


_FILE = ".lock"
_NO_LOCKS = {errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL}
"""What file systems answer that know no locks (some network shares)."""


@contextmanager
def only_training(run_dir: Path) -> Iterator[None]:
    """Hold a run directory while the block runs; made if it is not there.

    The operating system gives the lock back when the process ends, however it ends. If the block
    leaves no run behind, it leaves no directory either.

    Raises:
        BusyError: Another process trains there.
        ConfigurationError: The directory cannot be made.
    """
    made = not run_dir.exists()
    make_folder(run_dir)
    path = run_dir / _FILE
    with writing(path):
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        _lock(descriptor, run_dir)
        os.ftruncate(descriptor, 0)
        with suppress(OSError):  # only for messages; the disk may be full
            os.write(descriptor, str(os.getpid()).encode())
        yield
    finally:
        if made and not (run_dir / "config.json").exists():
            with suppress(OSError):
                path.unlink()
                run_dir.rmdir()
        os.close(descriptor)


def _lock(descriptor: int, run_dir: Path) -> None:
    try:
        import fcntl
    except ImportError:  # not on Windows
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        who = os.pread(descriptor, 20, 0).decode(errors="replace")
        raise BusyError(
            f"another training goes on in {run_dir} (process {who or 'unknown'}); wait for it, end "
            "it, or use another directory"
        ) from error
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
