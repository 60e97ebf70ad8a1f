"""Files and folders that commands write: one policy for all of them.

An output's folder is made. What exists is not replaced unless the user asks for it, and what a
command reads is never replaced, however the two are spelled. A file appears when it is whole: it
is written beside its place and renamed, so that a full disk or a kill leaves what was there.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from skewmi.errors import OutputError

_NO_SYNC = {errno.EINVAL, errno.ENOTSUP, errno.ENOSYS, errno.EBADF, errno.EACCES, errno.EISDIR}
"""What file systems answer that cannot sync a folder (older CIFS, some FUSE, Windows)."""
_LONGEST_NAME, _LONGEST_SUFFIX = 128, 32
"""Bytes of a draft's name that every file system takes: encrypting ones take 143, others 255."""


def check_output(path: Path, *, overwrite: bool, inputs: Sequence[Path | None] = ()) -> Path:
    """Make sure that a file may be written, before any work is done for it, and make its folder.

    Args:
        path: The file.
        overwrite: Whether it may replace an existing one.
        inputs: Files that the command reads or else writes; None is passed over.

    Returns:
        The file's own name: where a link points.

    Raises:
        OutputError: It must not or cannot be written.
    """
    target = Path(os.path.realpath(path))
    for given in inputs:
        if given is not None and _same(target, given):
            raise OutputError(
                f"{path} is also {given}, which this command needs; give another output"
            )
    try:
        mode = target.stat().st_mode if target.exists() else None
        if mode is not None and not stat.S_ISREG(mode):
            kind = "a folder" if stat.S_ISDIR(mode) else "no regular file"
            raise OutputError(f"cannot write {path}: it is {kind}; give the name of a file")
        if mode is not None and not overwrite:
            raise OutputError(f"{path} exists; give another output or --overwrite")
        make_folder(target.parent)
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(target.parent))
    except OSError as error:
        raise cannot_write(path, error) from error
    return target


def make_folder(folder: Path) -> Path:
    """Make a folder and those above it; return it.

    Raises:
        OutputError: It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise OutputError(f"cannot write {folder}: it, or what is above it, is a file") from error
    except OSError as error:
        raise cannot_write(folder, error) from error
    return folder


@contextmanager
def written_aside(path: Path) -> Iterator[Path]:
    """The name to write a file under, in its folder and with its suffix.

    When the block is left the file takes its place, or is removed if the block failed.

    Raises:
        OutputError: It cannot be written; the message says why and where.
    """
    target = Path(os.path.realpath(path))
    draft = target.with_name(_draft_name(target))
    try:
        with writing(path):
            yield draft
            sync(draft)
            os.replace(draft, target)
            sync(target.parent)
    finally:
        with suppress(OSError):
            draft.unlink(missing_ok=True)


def _draft_name(target: Path) -> str:
    """Hidden, of this process and this target alone, and legal wherever the target's name is."""
    end = f".{os.getpid()}.part"
    name = f".{target.stem}{end}{target.suffix}"
    if len(os.fsencode(name)) <= _LONGEST_NAME:
        return name
    digest = hashlib.sha256(os.fsencode(target.name)).hexdigest()[:16]
    # What chooses a format by the suffix knows no long one.
    suffix = target.suffix if len(os.fsencode(target.suffix)) <= _LONGEST_SUFFIX else ""
    return f".{digest}{end}{suffix}"


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """While the block runs, every error of the operating system is about writing this path.

    Raises:
        OutputError: In place of OSError; the message says why and where.
    """
    try:
        yield
    except OSError as error:
        raise cannot_write(path, error) from error


def cannot_write(path: Path, error: OSError) -> OutputError:
    """The error that says what could not be written where, and what to do about it."""
    reason = error.strerror or str(error)
    advice = ""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        advice = "; make room there, or write to another disk"
    elif error.errno == errno.EFBIG:
        advice = "; raise the limit on the size of files (ulimit -f)"
    elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        advice = "; give another place, or the right to write there"
    where = f" ({error.filename})" if error.filename not in (None, str(path)) else ""
    return OutputError(f"cannot write {path}: {reason}{where}{advice}")


def sync(path: Path) -> None:
    """Make a file or folder survive a power cut, as far as its file system can.

    Raises:
        OSError: It is missing, or the disk failed or is full.
    """
    folder = path.is_dir()
    try:
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        if not (folder and error.errno in _NO_SYNC):
            raise


def _same(target: Path, given: Path) -> bool:
    with suppress(OSError):
        if target.samefile(given):
            return True
    return target == Path(os.path.realpath(given))
