"""Reading back what a run has visited."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skewmi.policy_io import Array
from skewmi.train.blocks import read_blocks
from skewmi.train.checkpoint import read_checkpoint, read_run_header
from skewmi.train.replay import Index, Replay


def _read_history(run_dir: Path) -> Replay:
    """The episodes of a run's latest checkpoint."""
    config, layout = read_run_header(run_dir)
    checkpoint = read_checkpoint(run_dir)
    goal_dim = len(checkpoint.state["evaluation_goal"])
    history = Replay(layout, config.rollout.history_steps, goal_dim)
    read_blocks(history, checkpoint.path / "replay", int(checkpoint.state["episodes"]))
    return history


def visited_states(run_dir: Path) -> tuple[Array, Array]:
    """States of all episodes in a run's latest checkpoint, oldest first.

    Returns:
        States, shape (episodes, steps + 1, state_dim), and extrinsic rewards, shape
        (episodes, steps).

    Raises:
        CheckpointError: There is no such run or checkpoint, or it is damaged.
    """
    history = _read_history(run_dir)
    states, rewards = history.state_columns(_in_order(history))
    return states.astype(np.float64), rewards.astype(np.float64)


def pursued_goals(run_dir: Path) -> tuple[Array, Array]:
    """Beside the states what their episodes pursued, oldest first.

    Returns:
        States, shape (episodes, steps + 1, state_dim), and goals, shape (episodes, steps,
        goal_dim).

    Raises:
        CheckpointError: See `visited_states`.
    """
    history = _read_history(run_dir)
    slots = _in_order(history)
    states, _ = history.state_columns(slots)
    return states.astype(np.float64), history.goal_columns(slots).astype(np.float64)


def _in_order(history: Replay) -> Index:
    """Slots of the episodes that are held, oldest first."""
    first = history.count - len(history)
    slots: Index = np.arange(first, history.count) % history.capacity
    return slots
