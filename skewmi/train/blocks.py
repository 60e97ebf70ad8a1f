"""How the episodes of a replay are split into files, so that a checkpoint writes few of them.

Episode numbers are split like a binary counter: full blocks of 1024, then descending powers of
two. A new checkpoint links the blocks it shares with the one before and writes only the new
ones, so every episode is written about ten times in total, however long the run.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skewmi.errors import CheckpointError
from skewmi.train.files import link_or_copy, write_array
from skewmi.train.replay import Replay

LARGEST = 1024


def split(first: int, count: int) -> list[tuple[int, int]]:
    """(start, length) of the blocks that hold episodes first..count-1, in order.

    Blocks start at multiples of their length; the first may begin before `first`.
    """
    blocks = []
    start = 0
    while start < count:
        length = min(LARGEST, 1 << ((count - start).bit_length() - 1))
        if start + length > first:
            blocks.append((start, length))
        start += length
    return blocks


def block_name(start: int, length: int) -> str:
    """File name of a block."""
    return f"episodes-{start:09d}-{length:04d}.npy"


def write_blocks(replay: Replay, folder: Path, previous: Path | None) -> None:
    """Write the episodes of a replay into `folder`, linking what `previous` already holds."""
    folder.mkdir()
    for start, length in split(replay.count - len(replay), replay.count):
        name = block_name(start, length)
        if previous is not None and (previous / name).exists():
            link_or_copy(previous / name, folder / name)
            continue
        slots = np.arange(start, start + length) % replay.capacity
        # Rows of a block that the ring has overwritten meanwhile are written as they are now;
        # `read_blocks` leaves them out.
        write_array(folder / name, replay.rows[slots])


def read_blocks(replay: Replay, folder: Path, count: int) -> None:
    """Fill an empty replay with the latest of `count` episodes from `folder`.

    Raises:
        CheckpointError: A block is missing, unreadable or of another shape.
    """
    first = max(0, count - replay.capacity)
    for start, length in split(first, count):
        path = folder / block_name(start, length)
        try:
            rows = np.load(path, mmap_mode="r", allow_pickle=False)
        except (OSError, ValueError) as error:
            raise CheckpointError(f"cannot read replay block {path}: {error}") from error
        expected = (length, *replay.rows.shape[1:])
        if rows.shape != expected or rows.dtype != np.float32:
            raise CheckpointError(
                f"replay block {path} has shape {rows.shape}, {rows.dtype}; "
                f"this task needs {expected}, float32"
            )
        live = max(first, start)
        slots = np.arange(live, start + length) % replay.capacity
        replay.rows[slots] = rows[live - start :]
        replay.count = start + length
        replay.refresh_index(slots)
