"""One short real training run, shared by the tests of the commands that read runs."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from skewmi.cli.main import main


@pytest.fixture(scope="session")
def maze_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run directory of a few episodes in the maze; copy it before changing it."""
    torch.set_num_threads(1)
    run_dir = tmp_path_factory.mktemp("runs") / "maze"
    arguments = ["train", "--task", "point_maze", "--run-dir", str(run_dir), "--quiet", "--json"]
    assert main([*arguments, "--steps", "400", "--num-envs", "4"]) == 0
    return run_dir
