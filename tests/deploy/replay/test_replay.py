"""Replays: a recording becomes a file that Rerun shows."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded_motion import DURATION_S, PROFILE, Q_MIDDLE, SUCCESS_S, motion, write_recording
from rerun.chunk import RrdReader

from skewmi.cli.replay import ReplayCommand, run_replay
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.replay.assembler import understand
from skewmi.deploy.replay.data import Motion, tracking_error
from skewmi.deploy.replay.replay import write_replay
from skewmi.deploy.wire import messages, topics
from skewmi.deploy.wire.messages import JointStates, Status
from skewmi.errors import ConfigurationError
from skewmi.robot_models import frames, yumi
from skewmi.robot_models.kinematics import ArmKinematics


def test_run_is_what_was_recorded(recorded):
    run = understand(read_recording(recorded))
    # Tails are cut where the next chunk takes over; only the last is shown whole.
    expected_s = np.arange(len(run.commanded.time_s)) * 0.004
    np.testing.assert_allclose(run.commanded.time_s, expected_s, atol=1e-9)
    q, v, a = motion(expected_s)
    np.testing.assert_allclose(run.commanded.q, q, atol=1e-12)
    np.testing.assert_allclose(run.commanded.v, v, atol=1e-12)
    np.testing.assert_allclose(run.commanded.a, a, atol=1e-12)
    # Jerk of a sine: -rate^2 v.
    np.testing.assert_allclose(run.commanded.jerk[1:], -4.0 * v[1:], atol=0.02)
    position, _ = ArmKinematics("right").forward(q)
    np.testing.assert_allclose(run.commanded.hand_w, position + frames.BASE_IN_WORLD)
    assert len(run.measured.time_s) == DURATION_S * 50
    assert [(round(t, 3), s.message) for t, s in run.events] == [
        (0.0, "holding"),
        (0.22, "executing"),
    ]
    # The region is entered at 1.0 s and must be held for three steps.
    assert run.success_s == pytest.approx((SUCCESS_S,))
    assert run.malformed == 0


def test_file_holds_robot_scene_curves_and_events(recorded, tmp_path):
    out = tmp_path / "run.rrd"
    report = write_replay(recorded, out)
    assert report.success_s == pytest.approx((SUCCESS_S,))
    assert report.limit_use["velocity"] == pytest.approx(
        np.abs(motion(np.arange(0, 2.05, 0.004))[1] / PROFILE.velocity).max(), rel=0.01
    )
    assert report.tracking_error_mm is not None
    assert 0.5 < report.tracking_error_mm < 20.0
    rows: dict[str, int] = {}
    for chunk in RrdReader(out).stream().to_chunks():
        if not chunk.is_static:
            rows[str(chunk.entity_path)] = rows.get(str(chunk.entity_path), 0) + chunk.num_rows
    commanded, measured = 515, 100
    for joint in yumi.joint_names("right"):
        assert rows[f"/robot_measured/joints/{joint}"] == measured
        assert rows[f"/robot_commanded/joints/{joint}"] == commanded
    for quantity in ("position", "velocity", "acceleration", "jerk"):
        assert rows[f"/joints/{quantity}/of_limit"] == commanded
    assert rows["/world/hand/commanded"] == commanded
    assert rows["/world/scene/lid_hinge"] == rows["/world/scene/button_slide"] == measured
    assert rows["/policy/observation"] == rows["/policy/action/fields"] == 20
    assert rows["/events/endpoint"] == 2
    assert rows["/events/task"] == 1


def test_recording_without_metadata_or_with_a_torn_end_is_shown(recorded, tmp_path):
    bare = tmp_path / "bare.mcap"
    write_recording(bare, metadata=False)
    report = write_replay(bare, tmp_path / "bare.rrd")
    assert report.complete
    assert report.limit_use == {}
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(recorded.read_bytes()[:-20_000])
    report = write_replay(torn, tmp_path / "torn.rrd")
    assert not report.complete
    assert 0.5 < report.duration_s < DURATION_S + 0.08


def test_malformed_messages_are_counted_and_left_out(tmp_path):
    path = tmp_path / "run.mcap"
    states = JointStates(0, yumi.joint_names("right"), Q_MIDDLE, np.zeros(7), np.zeros(7))
    with RecordingWriter(path) as writer:
        writer.write(topics.YUMI_JOINT_STATES, messages.encode_joint_states(states))
        writer.write(topics.YUMI_JOINT_STATES, b"\x00\x01\x00\x00garbage")
    assert write_replay(path, tmp_path / "run.rrd").malformed == 1


def test_bad_input_is_refused_and_leaves_nothing_behind(tmp_path):
    out = tmp_path / "out.rrd"
    other = tmp_path / "other.mcap"
    with RecordingWriter(other) as writer:
        status = messages.encode_status(Status(0, "somebody", 0, "else"))
        writer.write(topics.YUMI_STATUS, status)
    text = tmp_path / "text.mcap"
    text.write_text("not a recording")
    for path, complaint in (
        (tmp_path / "absent.mcap", "no recording at"),
        (text, "not an MCAP recording"),
        (other, "holds neither"),
    ):
        with pytest.raises(ConfigurationError, match=complaint):
            write_replay(path, out)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["other.mcap", "text.mcap"]
    with pytest.raises(ConfigurationError, match="this command needs"):
        write_replay(other, tmp_path / "." / "other.mcap", overwrite=True)


def test_command_prints_one_json_document(recorded, tmp_path, capsys):
    out = tmp_path / "run.rrd"
    assert run_replay(ReplayCommand(recorded, out=out, json=True)) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["rrd"] == str(out)
    assert summary["messages"][topics.YUMI_TRAJECTORY.name] == 100
    assert out.is_file()
    with pytest.raises(ConfigurationError, match="not both"):
        run_replay(ReplayCommand(recorded, out=out, live=True))


def test_arm_moved_while_nothing_is_commanded_is_no_tracking_error(recorded: Path) -> None:
    run = understand(read_recording(recorded))
    before = np.abs(run.error.values).max()
    motion, measured = run.commanded, run.measured
    kept = (motion.time_s < 0.8) | (motion.time_s > 1.2)
    parts = (getattr(motion, name)[kept] for name in ("time_s", "q", "v", "a", "jerk"))
    idle = (measured.time_s > 0.81) & (measured.time_s < 1.19)
    moved = measured.q + np.where(idle, 0.5, 0.0)[:, None]
    error = tracking_error(Motion(*parts), replace(measured, q=moved))
    assert not ((error.time_s > 0.81) & (error.time_s < 1.19)).any()
    assert len(error.time_s) > len(measured.time_s) / 2
    assert np.abs(error.values).max() <= before + 1e-12


def test_arm_moved_while_time_stands_still_is_no_tracking_error(recorded: Path) -> None:
    """In lock-step a scene is reset, and the arm put elsewhere, between two states of one time."""
    run = understand(read_recording(recorded))
    measured, plain = run.measured, tracking_error(run.commanded, run.measured)
    at = int(np.searchsorted(measured.time_s, plain.time_s[len(plain.time_s) // 2]))
    twice = np.insert(np.arange(len(measured.time_s)), at, at)
    moved = measured.q[twice]
    moved[at + 1] += 0.3
    nothing = moved[:, :0]
    again = Motion(measured.time_s[twice], moved, nothing, nothing, nothing)
    found = tracking_error(run.commanded, again)
    kept = plain.time_s != measured.time_s[at]
    assert not kept.all()
    np.testing.assert_array_equal(found.time_s, plain.time_s[kept])
    np.testing.assert_allclose(found.values, plain.values[kept], atol=1e-12)
