"""A short real training run and a simulated robot, shared by the tests of commands."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from skewmi.cli.main import main
from skewmi.deploy.robot.process import spawn_robot


@pytest.fixture(scope="session")
def maze_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run directory of a few episodes in the maze; copy it before changing it."""
    torch.set_num_threads(1)
    run_dir = tmp_path_factory.mktemp("runs") / "maze"
    arguments = ["train", "--task", "point_maze", "--run-dir", str(run_dir), "--quiet", "--json"]
    assert main([*arguments, "--steps", "400", "--num-envs", "4"]) == 0
    return run_dir


@pytest.fixture(scope="module")
def lock_step_robot() -> Iterator[str]:
    """Locator of a simulated robot in a process of its own, which waits for its session."""
    with spawn_robot("sim", "open_press_close", "lab", lock_step=True) as locator:
        yield locator
