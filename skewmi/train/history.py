"""Reading back what a run has visited."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skewmi.policy_io import Array
from skewmi.train.blocks import read_blocks
from skewmi.train.checkpoint import read_checkpoint, read_run_header
from skewmi.train.replay import Replay


def visited_states(run_dir: Path) -> tuple[Array, Array]:
    """States of all episodes in a run's latest checkpoint, oldest first.

    Returns:
        States, shape (episodes, steps + 1, state_dim), and extrinsic rewards, shape
        (episodes, steps).

    Raises:
        CheckpointError: There is no such run or checkpoint, or it is damaged.
    """
    config, layout = read_run_header(run_dir)
    checkpoint = read_checkpoint(run_dir)
    replay = Replay(layout, config.replay.capacity_steps)
    read_blocks(replay, checkpoint.path / "replay", int(checkpoint.state["episodes"]))
    first = replay.count - len(replay)
    slots = np.arange(first, replay.count) % replay.capacity
    states, rewards = replay.state_columns(slots)
    return states.astype(np.float64), rewards.astype(np.float64)
