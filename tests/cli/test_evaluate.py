"""`skewmi evaluate`: runs, ONNX files and baselines."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from skewmi.cli.main import main

FIGURES = {
    "episodes",
    "successes",
    "success_rate",
    "success_rate_interval_95",
    "first_success_step",
    "first_success_time_s",
    "final_state",
    "task",
    "seed",
}


def figures_of(arguments: list[str], capfd: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert main(["evaluate", *arguments, "--json"]) == 0
    stdout, stderr = capfd.readouterr()
    assert stderr == ""
    figures: dict[str, Any] = json.loads(stdout)
    assert set(figures) >= FIGURES
    del figures["wall_time_s"]
    return figures


def test_run_and_its_onnx_file_give_the_same(
    maze_run: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    onnx = tmp_path / "policy.onnx"
    assert main(["export-onnx", str(maze_run), "--out", str(onnx), "--episodes", "1"]) == 0
    capfd.readouterr()
    common = ["--episodes", "3", "--seed", "7", "--option", "start_noise=0.2"]
    by_torch = figures_of([str(maze_run), *common], capfd)
    by_onnx = figures_of([str(onnx), "--task", "point_maze", *common], capfd)
    assert by_torch.pop("agent") == str(maze_run)
    assert by_onnx.pop("agent") == str(onnx)
    for name in ("x", "y"):
        torch_final, onnx_final = (f["final_state"].pop(name) for f in (by_torch, by_onnx))
        assert torch_final == pytest.approx(onnx_final, abs=1e-3)
    assert by_torch == by_onnx
    assert by_torch["episodes"] == 3
    assert by_torch["task"] == "point_maze"


def test_baselines_are_reproducible_and_differ(capfd: pytest.CaptureFixture[str]) -> None:
    common = ["--task", "point_maze", "--episodes", "4"]
    random = [
        figures_of(["--agent", "random", *common, "--seed", seed], capfd)
        for seed in ("1", "1", "2")
    ]
    assert random[0] == random[1]
    assert random[0]["final_state"] != random[2]["final_state"]
    still = figures_of(["--agent", "zero", *common], capfd)
    assert "contact" not in still
    assert still["agent"] == "zero"
    assert still["successes"] == 0
    assert still["final_state"]["x"]["max"] == still["final_state"]["x"]["min"] == 0.0


def test_zero_agent_stands_still_with_the_arm(capfd: pytest.CaptureFixture[str]) -> None:
    arguments = ["--agent", "zero", "--task", "open_press_close", "--episodes", "2"]
    figures = figures_of(arguments, capfd)
    assert figures["successes"] == 0
    assert figures["final_state"]["button_depth"]["max"] < 1e-3
    assert figures["final_state"]["lid_angle"]["max"] < 0.05
    contact = figures["contact"]
    assert contact["share_of_episodes_gentle"] == 1.0
    assert contact["hand_force_peak_n"]["max"] == 0.0


def test_text_says_rate_and_interval(capfd: pytest.CaptureFixture[str]) -> None:
    arguments = ["evaluate", "--agent", "zero", "--task", "point_maze", "--episodes", "10"]
    assert main(arguments) == 0
    stdout, stderr = capfd.readouterr()
    assert "0 of 10 episodes succeeded: 0.0% (95 % interval 0.0% to 27.8%)" in stdout
    assert stderr == ""


def test_bad_input_is_one_line_and_code_2(
    maze_run: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("no policy")
    for arguments, reason in (
        ([], "give a run directory or an ONNX file"),
        (["--agent", "zero"], "needs --task"),
        (["--agent", "zero", "--task", "cooking"], "point_maze"),
        ([str(tmp_path / "nothing")], "does not exist"),
        ([str(tmp_path)], "no run directory"),
        ([str(text)], "not a whole policy file"),
        ([str(maze_run), "--task", "open_press_close"], "trained on task 'point_maze'"),
        ([str(maze_run), "--episodes", "0"], "--episodes is 0"),
        ([str(maze_run), "--option", "time_input=false"], "another layout"),
    ):
        assert main(["evaluate", *arguments]) == 2, arguments
        stdout, stderr = capfd.readouterr()
        assert stdout == ""
        assert reason in stderr
        assert stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("task", "option", "reason"),
    [
        ("point_maze", 'start_noise="a"', "start_noise is 'a'"),
        ("point_maze", "time_input=3", "time_input is 3; it must be true or false"),
        ("open_press_close", "randomization=3", "from Python alone"),
        ("open_press_close", "gripper_action=2", "gripper_action is 2"),
    ],
)
def test_task_options_of_another_type_are_refused(
    task: str, option: str, reason: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", "--agent", "random", "--task", task, "--option", option]) == 2
    stdout, stderr = capfd.readouterr()
    assert (stdout, stderr.count("\n")) == ("", 1)
    assert reason in stderr
