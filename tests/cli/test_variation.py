"""--variation as a user gives it: to evaluate and to train."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from skewmi.cli.main import main
from skewmi.sim import tasks
from skewmi.train.checkpoint import read_run_header
from skewmi.train.policy import load_policy

VARIATIONS = tasks.find("open_press_close").variations
OPC = ["--task", "open_press_close"]


def figures(arguments: list[str], capfd: pytest.CaptureFixture[str]) -> dict:
    zero = ["evaluate", "--agent", "zero", "--episodes", "2", "--num-threads", "1", "--json"]
    assert main([*zero, *OPC, *arguments]) == 0
    return json.loads(capfd.readouterr().out)


def test_evaluate_runs_the_variation_it_is_given(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("sensors: {lid_bias_deg: 10}\n")
    nominal, given = figures([], capfd), figures(["--variation", str(path)], capfd)
    assert (nominal["variation"], given["variation"]) == ("nominal", str(path))
    lid = [f["final_state"]["lid_angle"]["median"] for f in (nominal, given)]
    assert lid[1] - lid[0] == pytest.approx(0.1745, abs=1e-3)


def test_a_run_keeps_the_variation_it_was_started_with(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, run_dir = tmp_path / "robot.yaml", tmp_path / "run"
    path.write_text("seed: 3\nservo: {kp_scale: [0.9, 1.1]}\n")
    variation = VARIATIONS.load(path)
    train = ["train", "--run-dir", str(run_dir), "--num-envs", "2", "--quiet"]
    assert main([*train, *OPC, "--variation", str(path), "--steps", "400"]) == 0
    path.write_text("servo: {kp_scale: 2}\n")  # what the run has is what the file said
    assert main([*train, "--resume", "--steps", "800"]) == 0
    config, _ = read_run_header(run_dir)
    assert VARIATIONS.parse(dict(config.task_options)["variation"]) == variation
    policy = load_policy(run_dir)
    assert VARIATIONS.parse(policy.metadata["task_options"]["variation"]) == variation
    assert policy.metadata["environment_steps"] == 800

    capsys.readouterr()
    assert main([*train, "--resume", "--steps", "1200", "--variation", str(path)]) == 2
    said = capsys.readouterr().err
    assert "is not what the run in" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([*OPC, "--variation", "nowhere.yaml"], "no variation file nowhere.yaml"),
        (["--task", "point_maze", "--variation", "randomised"], "nothing that varies"),
        ([*OPC, "--option", 'variation="randomised"'], "use --variation"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", "--agent", "zero", *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_the_former_flag_still_works_but_is_not_told(capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("evaluate", "train", "deploy", "robot"):
        with pytest.raises(SystemExit):
            main([command, "--help"])
        told = capsys.readouterr().out
        assert "--variation" in told
        assert "twin" not in told
    assert main(["evaluate", "--agent", "zero", *OPC, "--twin=nowhere.yaml"]) == 2
    assert "no variation file nowhere.yaml" in capsys.readouterr().err
