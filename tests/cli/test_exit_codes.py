"""What commands end with: a stop is a failure, an episode without success is a result."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skewmi.cli import deploy, play, way_flags
from skewmi.cli.main import main
from skewmi.deploy.report import DeployReport, EpisodeReport
from skewmi.deploy.way_motion import WayReport

MOVES = (["home"], ["jog", "--z", "5"])


def deployed(outcome: str, **more: Any) -> DeployReport:
    """A run of one episode that ended so."""
    episode = EpisodeReport(0, outcome, "for a reason", 200, 0, {}, {}, {})
    return DeployReport("open_press_close", "sim", "lab", 1.0, True, episodes=[episode], **more)


@pytest.mark.parametrize(
    ("report", "code"),
    [
        (deployed("success"), 0),
        (deployed("time over"), 0),
        (deployed("stopped", stops=["for a reason"]), 1),
        (deployed("fault", stops=["for a reason"]), 1),
        (deployed("success", broken_files=["run.mcap"]), 1),
        (deployed("stopped", stops=["interrupted"], interrupted=True), 130),
    ],
)
def test_a_deployment_that_runs_out_of_time_is_done(
    report: DeployReport,
    code: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(deploy, "deploy_policy", lambda options: report)
    assert main(["deploy", "open_press_close", "--json"]) == code
    assert json.loads(capsys.readouterr().out)["successes"] == report.successes


@pytest.mark.parametrize("command", MOVES, ids=lambda words: words[0])
@pytest.mark.parametrize(
    ("report", "code"),
    [
        (WayReport([("touch", "up")], measured=np.zeros(7)), 0),
        (WayReport([("touch", "up")], ["stop asked for"]), 1),
        (WayReport([("touch", "up")], ["interrupted"], interrupted=True), 130),
    ],
)
def test_an_arm_that_does_not_get_there_is_a_failure(
    command: list[str], report: WayReport, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(way_flags, "run_way", lambda *arguments, **options: report)
    assert main([*command, "--json"]) == code


@pytest.mark.parametrize("command", MOVES, ids=lambda words: words[0])
def test_an_arm_that_nobody_answers_for_is_refused(command: list[str]) -> None:
    assert main([*command, "--connect", "tcp/127.0.0.1:1"]) == 2


def test_evaluated_episodes_need_not_succeed(capsys: pytest.CaptureFixture[str]) -> None:
    zero = ["--agent", "zero", "--task", "point_maze", "--episodes", "2"]
    assert main(["evaluate", *zero, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["successes"] == 0


def test_played_episodes_need_not_succeed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shown = {"succeeded": 0, "episodes": 2}
    monkeypatch.setattr(play, "_shown", lambda *_: shown)
    zero = ["--agent", "zero", "--task", "point_maze"]
    assert main(["play", *zero, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == shown

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(play, "_shown", interrupted)
    out = tmp_path / "play.rrd"
    assert main(["play", *zero, "--out", str(out)]) == 130
    assert not out.exists()
