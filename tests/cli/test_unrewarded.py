"""`skewmi train --unrewarded`: every task, preset and method explores without a target."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from skewmi.cli.main import main
from skewmi.cli.train_config import resolve
from skewmi.cli.train_options import default_options
from skewmi.train.checkpoint import read_checkpoint, read_run_header
from skewmi.train.presets import PRESETS

SHORT = ["--task", "point_maze", "--num-envs", "2", "--quiet"]


@pytest.mark.parametrize(("task", "name"), PRESETS)
def test_every_preset_can_explore_without_a_target(task: str, name: str) -> None:
    arguments = ["--run-dir", "x", "--task", task, "--preset", name]
    options = replace(default_options(arguments), run_dir=Path("x"), task=task, preset=name)
    rewarded = resolve(options)
    assert rewarded.rewarded
    assert resolve(replace(options, unrewarded=True)) == replace(rewarded, rewarded=False)


def test_a_run_stays_what_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(tmp_path / "run")
    begin = ["train", "--run-dir", folder, *SHORT, "--steps", "400"]
    assert main([*begin, "--unrewarded", "--stop-on-convergence"]) == 2
    assert "without a reward nothing converges" in capsys.readouterr().err
    assert main([*begin, "--unrewarded", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["rewarded"] is False
    assert result["converged_at"] is result["converged_at_paper"] is None
    assert {"entropy", "coverage"} <= result["metrics"].keys() or result["refreshes"] == 0
    again = ["train", "--run-dir", folder, "--resume", "--steps", "800", "--quiet"]
    assert main([*again, "--stop-on-convergence"]) == 2
    capsys.readouterr()
    assert main(again) == 0
    assert not read_run_header(tmp_path / "run")[0].rewarded
    assert "explored without a target" in capsys.readouterr().out
    # Told what pays, from what was explored.
    told = ["train", "--run-dir", str(tmp_path / "told"), "--start-from", folder, "--quiet"]
    assert main([*told, "--steps", "1200"]) == 0
    assert read_run_header(tmp_path / "told")[0].rewarded
    assert main([*told, "--resume", "--unrewarded", "--steps", "1600"]) == 2
    assert "--unrewarded True (the run has False)" in capsys.readouterr().err


def test_what_was_paid_cannot_be_forgotten(
    maze_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    origin, folder = tmp_path / "origin", tmp_path / "run"
    shutil.copytree(maze_run, origin)
    begin = ["train", "--run-dir", str(folder), "--start-from", str(origin), "--unrewarded"]
    file = read_checkpoint(origin).path / "state.json"
    state = json.loads(file.read_text())
    assert state["rewarded_episodes"] == 0
    file.write_text(json.dumps({**state, "rewarded_episodes": 3}))
    assert main([*begin, "--quiet", "--steps", "1600"]) == 2
    error = capsys.readouterr().err
    assert "has met the reward in 3 episodes" in error
    assert "leave out --unrewarded" in error
    assert not folder.exists()
    file.write_text(json.dumps(state))
    assert main([*begin, "--quiet", "--steps", "1600"]) == 0
