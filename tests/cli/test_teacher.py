"""`skewmi train --teacher` as a user runs it: the maze, begun by an untrained policy's file."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import pytest
from tiny_policy import write_policy

from skewmi.cli.main import main
from skewmi.sim import tasks

SHORT = ["--task", "point_maze", "--num-envs", "2", "--rollout.taught-steps", "800", "--quiet"]


@pytest.fixture(scope="module")
def teacher(tmp_path_factory: pytest.TempPathFactory) -> Path:
    layout = tasks.make_batch("point_maze", 1, time_input=True).layout  # as the preset
    return write_policy(tmp_path_factory.mktemp("teacher") / "maze.onnx", layout)


def test_a_run_remembers_its_teacher_and_needs_it_until_it_is_over(
    teacher: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    line = ["train", "--run-dir", str(folder), *SHORT, "--teacher", str(teacher)]
    assert main([*line, "--steps", "400"]) == 0
    config = json.loads((folder / "config.json").read_text())["config"]
    digest = hashlib.sha256(teacher.read_bytes()).hexdigest()
    assert config["taught_by"] == f"maze.onnx, sha256 {digest}"
    resume = ["train", "--run-dir", str(folder), "--resume", "--quiet"]
    assert main([*resume, "--steps", "800"]) == 2
    assert "give the same --teacher again" in capsys.readouterr().err
    assert main([*line, "--resume", "--steps", "800"]) == 0
    assert "begun by maze.onnx" in capsys.readouterr().out
    capsys.readouterr()
    assert main([*line, "--resume", "--steps", "1200", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["steps"], result["taught_by"]) == (1200, config["taught_by"])
    # A run that begins with this one is not taught again.
    after = ["train", "--run-dir", str(tmp_path / "after"), "--start-from", str(folder)]
    assert main([*after, "--steps", "1600", "--quiet"]) == 0
    assert json.loads((tmp_path / "after" / "config.json").read_text())["config"]["taught_by"] == ""


def test_another_teacher_is_refused(
    teacher: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    line = ["train", "--run-dir", str(folder), *SHORT, "--steps", "400"]
    assert main([*line, "--teacher", str(teacher)]) == 0
    other = shutil.copy(teacher, tmp_path / "other.onnx")
    assert main([*line, "--resume", "--teacher", str(other)]) == 2
    assert "--teacher other.onnx" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--teacher", "open_pres_close"], "did you mean 'open_press_close'"),
        (["--teacher", "nothing.onnx"], "nothing.onnx does not exist; give an ONNX file of"),
        (["--teacher", "."], "--teacher . is no file; write a run's policy to one with"),
        (["--teacher", "open_press_close"], "the teacher"),
        (["--teacher", "open_press_close", "--start-from", "elsewhere"], ""),
    ],
)
def test_what_is_no_teacher_of_this_task_is_told(
    given: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", "--run-dir", str(tmp_path / "run"), *SHORT, *given]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "run" / "config.json").exists()
