"""--calibration as a user gives it: to evaluate, to train, and to robots."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from unknown_robots import exact_calibration, exact_egm_calibration

from skewmi.calibration.calibration_file import read_calibration, write_calibration
from skewmi.calibration.calibration_use import fingerprint
from skewmi.cli.main import main
from skewmi.deploy.robot.process import free_port
from skewmi.robot_models import yumi
from skewmi.sim.arm.known import Known
from skewmi.train.checkpoint import read_run_header

OPC = ["--task", "open_press_close"]
ZERO = ["evaluate", "--agent", "zero", "--episodes", "2", "--num-threads", "1", "--json"]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write_calibration(tmp_path / "robot.yaml", exact_calibration(0.5))


def test_evaluate_tells_the_calibration_it_was_given(
    file: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for arguments, told in (([], None), (["--calibration", str(file)], str(file))):
        assert main([*ZERO, *OPC, *arguments]) == 0
        assert json.loads(capfd.readouterr().out)["calibration"] == told


def test_a_run_keeps_the_calibration_it_was_started_with(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_dir, known = tmp_path / "run", Known.of(file)
    train = ["train", "--run-dir", str(run_dir), "--num-envs", "2", "--quiet"]
    assert main([*train, *OPC, "--calibration", str(file), "--steps", "400"]) == 0
    config, _ = read_run_header(run_dir)
    assert Known.of(str(dict(config.task_options)["calibration"])) == known
    write_calibration(file, exact_calibration(0.6), overwrite=True)
    capsys.readouterr()
    assert main([*train, "--resume", "--steps", "800", "--calibration", str(file)]) == 2
    said = capsys.readouterr().err
    assert "--calibration" in said
    assert "is not what the run in" in said


@pytest.mark.parametrize("command", ["evaluate", "robot", "deploy", "train"])
def test_a_file_that_is_not_there_or_of_another_robot_is_refused_in_one_line(
    command: str, file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = {
        "evaluate": ["--agent", "zero", *OPC],
        "train": ["--run-dir", str(tmp_path / "run"), *OPC, "--steps", "400"],
        "robot": [],
        "deploy": ["open_press_close"],
    }[command]
    other = tmp_path / "other.yaml"
    other.write_text(file.read_text().replace(yumi.MODEL_HASH, "f" * 64))
    for path, said in ((tmp_path / "none.yaml", "no calibration file"), (other, "robot model")):
        assert main([command, *given, "--calibration", str(path)]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["evaluate", "--agent", "zero", "--task", "point_maze"], "has no robot"),
        (["robot", "--backend", "hold"], "no servos to know"),
        (["robot", "--backend", "egm-emulator"], "to the bridge"),
    ],
)
def test_who_has_no_use_for_one_says_so(
    arguments: list[str], said: str, file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if "hold" in arguments:  # Whatever listens at the usual port.
        arguments = [*arguments, "--listen", f"tcp/127.0.0.1:{free_port()}"]
    assert main([*arguments, "--calibration", str(file)]) == 2
    assert said in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("arguments", "egm", "said"),
    [
        (["robot", "--backend", "egm"], False, "behind EGM"),
        (["robot", "--backend", "sim"], True, "guided by EGM"),
        (["evaluate", "--agent", "zero", *OPC], True, "guided by EGM"),
        (["deploy", "open_press_close"], True, "guided by EGM"),
        (["deploy", "open_press_close", "--robot", "egm-emulator"], False, "behind EGM"),
        (["robot", "--backend", "egm", "--egm-feed-forward", "0.5"], True, "--egm-feed-forward 1"),
    ],
)
def test_one_of_another_kind_of_robot_is_refused_with_what_to_do(
    arguments: list[str], egm: bool, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known = exact_egm_calibration() if egm else exact_calibration()
    file = write_calibration(tmp_path / "other.yaml", known)
    assert main([*arguments, "--calibration", str(file)]) == 2
    assert said in " ".join(capsys.readouterr().err.split())


def test_a_robot_server_tells_which_calibration_it_uses(file: Path) -> None:
    command = [sys.executable, "-m", "skewmi.cli.main", "robot", "--json", "--end-with-input"]
    command += ["--listen", f"tcp/127.0.0.1:{free_port()}", "--calibration", str(file)]
    pipe = subprocess.PIPE
    robot = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
    assert robot.stdout is not None
    told = json.loads(robot.stdout.readline())
    robot.communicate(timeout=60.0)
    assert told["calibration"] == fingerprint(read_calibration(file))
