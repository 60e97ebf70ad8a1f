"""The demo as a newcomer runs it: every step, every file, an honest summary."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from skewmi.cli.main import main


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
    assert main(["demo", "--out", str(tmp_path), "--task", "no_such_task"]) == 2
    assert "skewmi train" in capsys.readouterr().err
