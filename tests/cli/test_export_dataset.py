"""`skewmi export-dataset`: every recorded step of a policy is a frame, and nothing else is."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest

from skewmi.cli.main import main
from skewmi.deploy.recording.reader import METADATA_NAME, run_metadata
from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.session.news import SessionNews
from skewmi.deploy.session.states import SessionEvent, SessionState
from skewmi.deploy.wire import messages, topics
from skewmi.deploy.wire.messages import JointStates
from skewmi.robot_models import yumi
from skewmi.sim import tasks

LAYOUT = tasks.layout("open_press_close")
ARM = (*yumi.joint_names("right"), yumi.finger_names("right")[0])
STEPS = 7
SOLVED = np.array([0.0, 0.0, 0.27, 0.014, 0.0, 0.02])


def joints(stamp_ns: int, names: Sequence[str], values: np.ndarray) -> bytes:
    nothing = values[:0]
    return messages.encode_joint_states(
        JointStates(stamp_ns, tuple(names), values, nothing, nothing)
    )


def news(stamp_ns: int, source: SessionState, state: SessionState, event: SessionEvent) -> bytes:
    return SessionNews(stamp_ns, state, "", source, event).encode()


def write_recording(
    path: Path,
    outcomes: Sequence[SessionState],
    *,
    layout: Any = LAYOUT,
    step_ms: int = 100,
    lose: tuple[int, int] | None = None,
) -> None:
    """One episode per outcome; `lose` is an episode and a step whose observation is missing."""
    rng = np.random.default_rng(len(outcomes))
    gid = bytes(range(16))
    with RecordingWriter(path) as writer:
        writer.add_metadata(METADATA_NAME, run_metadata(layout_json=layout.to_json(), seed="3"))
        sequence = 0
        for number, outcome in enumerate(outcomes):
            begin = (5 + 10 * number) * 10**9
            started = news(
                begin, SessionState.TO_START, SessionState.RUNNING, SessionEvent.AT_START
            )
            writer.write(topics.YUMI_STATUS, started)
            for step in range(STEPS + 1):
                stamp = begin + step * step_ms * 1_000_000
                sequence += 1
                arm = joints(stamp, ARM, rng.standard_normal(len(ARM)))
                writer.write(topics.YUMI_JOINT_STATES, arm)
                seen = rng.uniform(-0.1, 0.1, len(layout.observation_names))
                if step == STEPS and outcome is SessionState.SUCCESS:
                    seen[: len(SOLVED)] = SOLVED[: len(seen)]
                if (number, step) == lose:
                    continue
                observation = joints(stamp, layout.observation_names, seen)
                writer.write(topics.POLICY_OBSERVATION, observation, sequence=sequence, sender=gid)
                if step < STEPS:
                    names = [field.name for field in layout.action]
                    action = joints(stamp, names, rng.uniform(-1.0, 1.0, len(names)))
                    writer.write(topics.POLICY_ACTION, action, sequence=sequence, sender=gid)
            event = SessionEvent.SUCCESS if outcome is SessionState.SUCCESS else SessionEvent.STOP
            ended = news(stamp, SessionState.RUNNING, outcome, event)
            writer.write(topics.YUMI_STATUS, ended)


def export(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert main(["export-dataset", *arguments, "--json"]) == 0
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    return document


def frames_of(folder: Path) -> Any:
    (path,) = folder.glob("data/*/*.parquet")
    return pyarrow.parquet.read_table(path)


SOLVED_AND_NOT = (SessionState.SUCCESS, SessionState.STOPPING)


def test_every_step_is_a_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, two, out = tmp_path / "one.mcap", tmp_path / "two.mcap", tmp_path / "deep" / "set"
    write_recording(one, SOLVED_AND_NOT)
    write_recording(two, [SessionState.SUCCESS])
    told = export([str(one), str(two), "--out", str(out)], capsys)
    assert (told["episodes"], told["successes"], told["frames"]) == (3, 2, 3 * STEPS)
    frames = frames_of(out)
    ends = [False] * (STEPS - 1) + [True]
    assert frames["next.done"].to_pylist() == ends * 3
    assert frames["next.success"].to_pylist() == [*ends, *([False] * STEPS), *ends]
    assert frames["next.reward"].to_pylist() == frames["next.success"].cast("float").to_pylist()
    info = json.loads((out / "meta" / "info.json").read_text())
    assert info["fps"] == 10
    features = info["features"]
    assert features["observation.state"]["names"] == list(LAYOUT.observation_names)
    assert features["observation.joint_positions"]["names"] == list(ARM)
    about = json.loads((out / "meta" / "skewmi.json").read_text())
    sources = [episode["recording"] for episode in about["episodes"]]
    assert sources == ["one.mcap", "one.mcap", "two.mcap"]
    assert about["run"]["seed"] == "3"


def test_slower_runs_have_fewer_frames_a_second(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_recording(tmp_path / "one.mcap", SOLVED_AND_NOT, step_ms=200)
    export([str(tmp_path / "one.mcap"), "--out", str(tmp_path / "set")], capsys)
    assert json.loads((tmp_path / "set" / "meta" / "info.json").read_text())["fps"] == 5


def test_episodes_with_gaps_and_failures_can_be_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "one.mcap"
    write_recording(path, (*SOLVED_AND_NOT, SessionState.SUCCESS), lose=(0, 3))
    assert main(["export-dataset", str(path), "--out", str(tmp_path / "a"), "--json"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["episodes"] == 2
    assert "episode 1 is left out, its recording has gaps" in captured.err
    told = export([str(path), "--out", str(tmp_path / "b"), "--only-successes"], capsys)
    assert told["episodes"] == told["successes"] == 1


def test_what_exists_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "one.mcap", tmp_path / "set"
    write_recording(path, SOLVED_AND_NOT)
    arguments = ["export-dataset", str(path), "--out", str(out)]
    assert main(arguments) == 0
    assert main(arguments) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main([*arguments, "--overwrite"]) == 0
    assert sorted(item.name for item in tmp_path.iterdir()) == ["one.mcap", "set"]
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "precious").write_text("x")
    for other in (tmp_path / "mine", tmp_path):
        assert main(["export-dataset", str(path), "--out", str(other), "--overwrite"]) == 2
    assert (tmp_path / "mine" / "precious").exists()
    assert path.exists()


def test_recordings_of_different_runs_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, slow, door = (tmp_path / f"{name}.mcap" for name in ("one", "slow", "door"))
    write_recording(one, SOLVED_AND_NOT)
    write_recording(slow, SOLVED_AND_NOT, step_ms=200)
    write_recording(door, SOLVED_AND_NOT, layout=tasks.layout("door_open"))
    for other, words in ((slow, "200 ms"), (door, "door_open")):
        out = str(tmp_path / "set")
        assert main(["export-dataset", str(one), str(other), "--out", out]) == 2
        said = capsys.readouterr().err
        assert words in said
        assert "export them apart" in said
    assert not (tmp_path / "set").exists()
    assert main(["export-dataset", str(tmp_path / "no.mcap"), "--out", out]) == 2
    assert "no recording at" in capsys.readouterr().err
