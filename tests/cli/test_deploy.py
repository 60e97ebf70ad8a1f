"""`skewmi deploy` with real policy files: what it prints, refuses and exits with."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console
from robot_servers import once_running
from tiny_policy import write_policy

from skewmi.cli.deploy import print_report
from skewmi.cli.main import main
from skewmi.deploy.report import DeployReport
from skewmi.deploy.robot.process import spawn_robot
from skewmi.sim.tasks.open_press_close.definition import make_layout


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_policy(tmp_path_factory.mktemp("policy") / "tiny.onnx")


def one_line(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> str:
    """Run a command that must fail as bad input; its message, without progress lines."""
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = [line for line in captured.err.splitlines() if line.startswith("skewmi deploy: ")]
    assert len(lines) == 1, captured.err
    assert "Traceback" not in captured.err
    return lines[0]


def test_deploy_runs_a_policy_file_and_prints_one_json_document(
    lock_step_robot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = write_policy(tmp_path / "tiny.onnx", make_layout(time_input=True))
    recording = tmp_path / "run.mcap"
    arguments = ["deploy", str(policy), "--lock-step", "--connect", lock_step_robot]
    arguments += ["--episodes", "1", "--json"]
    assert main([*arguments, "--record", str(recording)]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["episodes"], report["successes"], report["success_rate"]) == (1, 0, 0.0)
    (episode,) = report["per_episode"]
    assert episode["outcome"] == "time over"
    assert episode["steps"] == 200
    assert report["cycles"] >= 1000
    assert set(report["cycle_ms"]) >= {"p50", "p99", "p99.9"}
    assert report["missed_cycles"] == 0
    assert report["stops"] == []
    for name in ("position", "velocity", "acceleration", "jerk"):
        assert 0.0 < report["limit_fractions"][name] <= 1.0 + 1e-6
    assert report["files"] == [str(recording)]
    assert recording.stat().st_size > 10_000
    line = one_line(capsys, [*arguments, "--record", str(recording)])
    assert "exists" in line


def test_policy_of_another_layout_is_refused(
    lock_step_robot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    layout = replace(make_layout(), control_dt=0.2)
    policy = write_policy(tmp_path / "other.onnx", layout)
    there = ["--lock-step", "--connect", lock_step_robot]
    assert "layout" in one_line(capsys, ["deploy", str(policy), *there])


def test_policy_of_another_robot_model_is_refused(
    lock_step_robot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = write_policy(tmp_path / "other.onnx", robot_model_hash="0" * 64)
    there = ["--lock-step", "--connect", lock_step_robot]
    assert "robot model" in one_line(capsys, ["deploy", str(policy), *there])


def test_policy_of_another_task_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    layout = replace(make_layout(), task="point_maze", workspace=None)
    policy = write_policy(tmp_path / "maze.onnx", layout)
    assert "point_maze" in one_line(capsys, ["deploy", str(policy)])


def test_files_that_are_no_policy_are_refused(
    tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = tiny.read_bytes()
    contents = {"empty": b"", "text": b"hello", "cut": good[: len(good) // 2]}
    for name, content in contents.items():
        path = tmp_path / f"{name}.onnx"
        path.write_bytes(content)
        assert str(path) in one_line(capsys, ["deploy", str(path)])
    assert "no.onnx" in one_line(capsys, ["deploy", str(tmp_path / "no.onnx")])


@pytest.mark.parametrize(
    "flags",
    [
        ["--episodes", "0"],
        ["--speed", "0.05"],
        ["--speed", "1.5"],
        ["--lead-ms", "10"],
        ["--limits", "wild"],
        ["--dry-run", "--lock-step"],
        ["--connect", "localhost"],
    ],
    ids=" ".join,
)
def test_bad_flags_are_one_line(
    tiny: Path, capsys: pytest.CaptureFixture[str], flags: list[str]
) -> None:
    one_line(capsys, ["deploy", str(tiny), *flags])


def test_run_that_was_stopped_exits_1_and_tells_why(
    tiny: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with spawn_robot("sim", "open_press_close", "lab", lock_step=False) as locator:
        stopper = once_running(locator, lambda: main(["stop", "--json", "--connect", locator]))
        arguments = ["deploy", str(tiny), "--connect", locator, "--episodes", "2", "--json"]
        assert main(arguments) == 1
        stopper.join()
    stopped, report = sorted(map(json.loads, capsys.readouterr().out.splitlines()), key=len)
    assert stopped["state"] == "disarmed"
    assert report["episodes"] == 1
    assert report["per_episode"][0]["outcome"] == "stopped"
    assert report["stops"] == [report["per_episode"][0]["reason"]]
    assert "skewmi stop" in report["stops"][0]


def deploying(policy: Path, *options: str) -> subprocess.Popen[str]:
    """The command in a process of its own; from its first words on it ends smoothly."""
    command = [sys.executable, "-m", "skewmi.cli.main", "deploy", str(policy), "--json", *options]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # The tests themselves may run under nohup.
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_command_interrupted_in_an_episode_exits_130(
    lock_step_robot: str, tiny: Path, number: signal.Signals
) -> None:
    children: list[subprocess.Popen[str]] = []
    interrupter = once_running(lock_step_robot, lambda: children[0].send_signal(number))
    child = deploying(tiny, "--lock-step", "--connect", lock_step_robot)
    children.append(child)
    out, err = child.communicate(timeout=120.0)
    interrupter.join()
    assert child.returncode == 130, err
    assert "Traceback" not in err
    report = json.loads(out)
    assert report["interrupted"]
    assert report["per_episode"][0]["outcome"] == "stopped"


def test_command_interrupted_before_an_episode_exits_130(tiny: Path) -> None:
    child = deploying(tiny)
    assert child.stderr is not None
    child.stderr.readline()
    child.send_signal(signal.SIGHUP)
    out, err = child.communicate(timeout=120.0)
    assert child.returncode == 130, err
    assert "Traceback" not in err
    assert out == "" or json.loads(out)["interrupted"]


def test_people_are_told_of_a_dry_run_and_of_reduced_limits(tmp_path: Path) -> None:
    def printed(**changes) -> str:
        console = Console(file=(tmp_path / "out").open("w"), width=200)
        print_report(DeployReport("t", "sim", "lab", 1.0, lock_step=True, **changes), console)
        console.file.close()
        return (tmp_path / "out").read_text()

    assert "dry run" not in printed()
    assert "dry run: nothing was sent" in printed(dry_run=True)
    assert "(lab):" in printed()
    assert "(lab, velocity at most 30% of full):" in printed(velocity_fraction=0.3)
    assert "not whole: x.mcap" in printed(broken_files=["x.mcap"])
