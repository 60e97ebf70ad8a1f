"""Comparing two run directories to the last bit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from skewmi.batch_env import BatchEnv
from skewmi.train.checkpoint import read_checkpoint
from skewmi.train.columns import TIME_COLUMNS
from skewmi.train.config import TrainConfig
from skewmi.train.log import read_metrics
from skewmi.train.run import run_train
from skewmi.train.state import split


def assert_same_table(one: Path, other: Path) -> None:
    """Equal metrics but for the columns about time."""
    a, b = read_metrics(one), read_metrics(other)
    assert a.keys() == b.keys()
    for name in a.keys() - set(TIME_COLUMNS):
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def assert_same_checkpoint(one: Path, other: Path, capacity: float = math.inf) -> None:
    """Equal state and episodes in the latest checkpoints.

    Args:
        one, other: Run directories.
        capacity: Episodes that the history keeps. Rows that its ring has overwritten meanwhile
            may differ in the files.
    """
    a, b = read_checkpoint(one), read_checkpoint(other)
    (tensors, state), (other_tensors, other_state) = split(a.state), split(b.state)
    assert state == other_state
    assert tensors.keys() == other_tensors.keys()
    for name, tensor in tensors.items():
        assert torch.equal(tensor, other_tensors[name]), name
    blocks = sorted(p.name for p in (a.path / "replay").iterdir())
    assert blocks == sorted(p.name for p in (b.path / "replay").iterdir())
    for name in blocks:
        ours = np.load(a.path / "replay" / name)
        first = int(max(0, a.state["episodes"] - capacity - int(name.split("-")[1])))
        np.testing.assert_array_equal(ours[first:], np.load(b.path / "replay" / name)[first:])


def resumes_alike(
    config: TrainConfig, make_env: Callable[[], BatchEnv], folder: Path, steps: int
) -> Path:
    """Run at once, and interrupted after so many environment steps; where the whole run is."""
    whole, parts = folder / "whole", folder / "parts"
    run_train(config, make_env(), whole, progress=False)
    run_train(replace(config, total_steps=steps), make_env(), parts, progress=False)
    run_train(config, make_env(), parts, resume=True, progress=False)
    assert_same_table(whole, parts)
    env = make_env()
    assert_same_checkpoint(whole, parts, config.rollout.history_steps // env.layout.episode_steps)
    return whole
