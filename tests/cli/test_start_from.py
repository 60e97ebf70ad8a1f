"""`skewmi train --start-from`: what a run begun from another one may do otherwise, and has to."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skewmi.cli.main import main
from skewmi.train.checkpoint import read_run_header
from skewmi.train.history import visited_states
from skewmi.train.log import read_metrics


def test_a_run_can_begin_with_another_ones_networks_and_replay(
    maze_run: Path, tmp_path, capsys
) -> None:
    folder = tmp_path / "second"
    begin = read_metrics(maze_run)["step"][-1]
    arguments = ["train", "--run-dir", str(folder), "--start-from", str(maze_run), "--seed", "6"]
    assert main([*arguments, "--steps", str(int(begin) + 800), "--json", "--quiet"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["steps"] == begin + 800
    config = json.loads((folder / "config.json").read_text())["config"]
    assert config["seed"] == 6
    assert config["started_from"] == f"{maze_run.name}, step {int(begin)}"
    ours, _ = visited_states(folder)
    theirs, _ = visited_states(maze_run)
    np.testing.assert_array_equal(ours[: len(theirs)], theirs)
    # It is a run of its own: it resumes without the other one.
    again = ["train", "--run-dir", str(folder), "--resume", "--steps", str(int(begin) + 1600)]
    assert main([*again, "--quiet"]) == 0


def test_a_run_from_another_may_compute_its_updates_otherwise(
    maze_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    begin = ["train", "--run-dir", str(folder), "--start-from", str(maze_run), "--quiet"]
    steps = int(read_metrics(maze_run)["step"][-1])
    other = ["--learner.engine", "eager"]
    assert main([*begin, *other, "--learner.n-step", "7"]) == 2
    assert "leave out --learner.n-step:" in capsys.readouterr().err
    assert main([*begin, *other, "--steps", str(steps + 800)]) == 0
    before, now = (read_run_header(path)[0].learner for path in (maze_run, folder))
    assert (before.engine, now) == ("auto", replace(before, engine="eager"))
    again = ["train", "--run-dir", str(folder), "--resume", "--steps", str(steps + 1600), "--quiet"]
    assert main([*again, "--learner.engine", "auto"]) == 2
    assert "leave out --learner.engine" in capsys.readouterr().err
    assert main(again) == 0
