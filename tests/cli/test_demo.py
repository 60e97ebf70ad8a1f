"""The demo as a newcomer runs it: every step, every file, an honest summary."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from skewmi import policies
from skewmi.cli.demo import DemoCommand
from skewmi.cli.main import main
from skewmi.sim import tasks
from skewmi.train.presets import PRESETS


@pytest.mark.slow
def test_demo_leaves_policy_recording_replay_and_pictures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(["demo", "--out", str(tmp_path), "--minutes", "0.2", "--episodes", "1", "--json"]) == 0
    )
    document = json.loads(capsys.readouterr().out)
    for name, path in document["files"].items():
        assert Path(path).exists(), name
    deployed = document["steps"]["deploy"]
    assert deployed["episodes"] == 1
    shares = deployed["limit_fractions"]
    assert all(0.0 < shares[limit] <= 1.0 for limit in ("velocity", "acceleration", "jerk"))
    assert document["steps"]["film"]["frames"] > 1
    # Something to look at comes first.
    assert list(document["steps"])[:3] == ["deploy", "film", "replay"]
    assert (Path(document["files"]["run"]) / "coverage.png").exists()
    assert document["steps"]["train"]["metrics"]["trajectories"] > 0
    for line in document["next"]:
        assert line.split()[0] in ("skewmi", "rerun")


@pytest.mark.parametrize(
    ("flag", "value"), [("--minutes", "0"), ("--episodes", "0"), ("--minutes", "nan")]
)
def test_impossible_numbers_are_refused_before_anything_is_written(
    flag: str, value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "demo"
    assert main(["demo", "--out", str(out), flag, value]) == 2
    assert flag in capsys.readouterr().err
    assert not out.exists()


def test_a_step_that_fails_ends_the_demo_with_its_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--out", str(tmp_path), "--policy", "no_such_policy"]) == 2
    assert "skewmi deploy no_such_policy" in capsys.readouterr().err


def test_task_that_there_is_not_is_refused_before_anything_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--out", str(tmp_path / "demo"), "--task", "no_such_task"]) == 2
    assert "no_such_task" in capsys.readouterr().err
    assert not (tmp_path / "demo").exists()


def test_demo_trains_what_is_learned_in_minutes() -> None:
    """Its flags are those of `skewmi train`, and name presets and targets that exist."""
    options = DemoCommand()
    spec = tasks.find(options.task)
    assert spec.demo
    flags = dict(zip(spec.demo[::2], spec.demo[1::2], strict=True))
    assert (options.task, flags["--preset"]) in PRESETS
    assert flags["--option"].removeprefix("target=") in spec.targets
    assert options.policy in policies.bundled()
