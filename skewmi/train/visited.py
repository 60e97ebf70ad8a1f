"""What a run has visited, and in which of its trajectories."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skewmi.errors import CheckpointError
from skewmi.policy_io import Array
from skewmi.train.checkpoint import read_checkpoint
from skewmi.train.history import visited_states

_TRIES = 3


def visited_trajectories(run_dir: Path) -> tuple[Array, NDArray[np.int64]]:
    """States of a run's latest checkpoint, oldest first, and the numbers of their trajectories.

    The history of a run is a ring: of more trajectories than it has room for it holds the last.

    Args:
        run_dir: Of the run, which may be going on.

    Returns:
        States, shape (trajectories, steps + 1, state_dim), in the layout's units; and numbers,
        counted from the run's first trajectory, which is 1. Shape (trajectories,).

    Raises:
        CheckpointError: There is no such run or checkpoint, it is damaged, or the run writes
            checkpoints faster than they can be read.
    """
    made = _made(run_dir)
    for _ in range(_TRIES):
        states, _rewards = visited_states(run_dir)
        # A checkpoint that came in between would number its states like those of another one.
        before, made = made, _made(run_dir)
        if made == before:
            return states, np.arange(made - len(states), made) + 1
    raise CheckpointError(f"the run in {run_dir} goes on faster than its states can be read")


def _made(run_dir: Path) -> int:
    """Trajectories until the latest checkpoint."""
    return int(read_checkpoint(run_dir).state["episodes"])
