"""Files that are either whole or not there, whenever the process dies."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skewmi.outputs import sync, writing


def write_text(path: Path, text: str) -> None:
    """Replace a file's content in one step.

    Raises:
        OutputError: It cannot be written.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    with writing(path):
        temporary.write_text(text)
        sync(temporary)
        os.replace(temporary, path)


def write_array(path: Path, array: NDArray[np.generic]) -> None:
    """Write a .npy file and wait until it is on the disk."""
    with path.open("wb") as file:
        np.save(file, array, allow_pickle=False)
        file.flush()
        os.fsync(file.fileno())


def link_or_copy(source: Path, target: Path) -> None:
    """A second name for a file that nobody changes; a copy where links are not possible."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)
