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
    goal_dim = len(checkpoint.state["evaluation_goal"])
    history = Replay(layout, config.rollout.history_steps, goal_dim)
    read_blocks(history, checkpoint.path / "replay", int(checkpoint.state["episodes"]))
    first = history.count - len(history)
    slots = np.arange(first, history.count) % history.capacity
    states, rewards = history.state_columns(slots)
    return states.astype(np.float64), rewards.astype(np.float64)
