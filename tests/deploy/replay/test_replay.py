"""Replay: what goes into a recording comes out of the Rerun file, at the right time and place."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from rerun.chunk import RrdReader

from skewmi.cli.replay import ReplayCommand, run_replay
from skewmi.deploy.recording.reader import METADATA_NAME, read_recording, run_metadata
from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.replay.assembler import understand
from skewmi.deploy.replay.data import Motion, tracking_error
from skewmi.deploy.replay.replay import write_replay
from skewmi.deploy.robot.backends.mujoco.scene_geometry import scene_geometry
from skewmi.deploy.wire import messages, topics
from skewmi.deploy.wire.messages import JointStates, Status
from skewmi.deploy.wire.scene_geometry import SceneGeometry
from skewmi.errors import ConfigurationError
from skewmi.policy_io import ActionField, Ball, Field, PolicyLayout, Workspace
from skewmi.robot_models import frames, limits, yumi
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import JointTrajectory, TrajectoryChunk

GRID_NS = 4_000_000
CYCLE_NS = 20_000_000
EPOCH_NS = 3_000_000_000
"""Robot server clock at the start of the recording."""
DURATION_S = 2.0
SUCCESS_S = 1.2

Q_MIDDLE = np.array([0.9, -1.6, -1.2, 0.5, 0.3, 1.0, 0.2])
PROFILE = limits.profile("lab")

LAYOUT = PolicyLayout(
    task="test",
    observation=(
        Field("hand_x", "m", "world", -0.1, 0.5),
        Field("button_depth", "m", "world", 0.0, 0.02),
    ),
    action=tuple(ActionField(f"v{axis}", "m", "world", 0.01) for axis in "xyz"),
    reward_region=(Ball(("button_depth",), (0.015,), 0.005),),
    control_dt=0.1,
    episode_steps=20,
    success_hold_steps=3,
    workspace=Workspace(
        low=(-0.1, -0.6, 0.0),
        high=(0.5, 0.2, 0.6),
        start=(0.1, 0.0, 0.3),
        base_position=(-0.4, 0.0, 0.0),
        hand_quaternion_wxyz=(0.0, 1.0, 0.0, 0.0),
        free_lead=1.0,
        held_lead=0.3,
        stop_lead=0.45,
        start_configuration=tuple(Q_MIDDLE),
        gripper_opening=0.01,
    ),
)

SCENE = """
<mujoco><worldbody>
  <geom type="plane" size="1 1 1"/>
  <body name="yumi_link_1_r"><geom type="box" size="9 9 9"/></body>
  <body name="box" pos="0.1 0 0"><geom name="wall" type="box" size="0.1 0.01 0.05"/>
    <body name="lid" pos="0 0.1 0.05">
      <joint name="lid_hinge" type="hinge" axis="1 0 0"/>
      <geom name="plate" type="box" size="0.1 0.1 0.001" pos="0 -0.1 0" rgba="0 0 1 1"/>
    </body>
    <body name="button"><joint name="button_slide" type="slide" axis="0 0 -1"/>
      <geom name="knob" type="cylinder" size="0.02 0.01"/></body>
  </body>
</worldbody></mujoco>
"""


def motion(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A sine on all joints: q, v, a. Shapes (n, 7)."""
    amplitude, rate = 0.15, 2.0
    phase = rate * time_s[:, None] + np.arange(7)
    q = Q_MIDDLE + amplitude * np.sin(phase)
    return q, amplitude * rate * np.cos(phase), -amplitude * rate**2 * np.sin(phase)


def write_recording(path: Path, *, metadata: bool = True) -> None:
    """Two seconds: chunks with tails every 20 ms, states, observations, events, success."""
    names = yumi.joint_names("right")
    finger = yumi.finger_names("right")[0]
    model = mujoco.MjModel.from_xml_string(SCENE)
    with RecordingWriter(path) as writer:
        if metadata:
            bounds = {
                name: getattr(PROFILE, name)
                for name in ("position_lower", "position_upper", "velocity", "acceleration", "jerk")
            }
            content = run_metadata(
                layout_json=LAYOUT.to_json(),
                limits=bounds,
                scene=scene_geometry(model).to_json(),
            )
            writer.add_metadata(METADATA_NAME, content)
        for cycle in range(int(DURATION_S * 50)):
            stamp_ns = EPOCH_NS + cycle * CYCLE_NS
            now_s = cycle * 0.02
            chunk_s = now_s + np.arange(20) * 0.004
            chunk = TrajectoryChunk.of(stamp_ns, names, JointTrajectory(*motion(chunk_s)))
            writer.write(topics.YUMI_TRAJECTORY, messages.encode_chunk(chunk))
            q, v, _ = motion(np.array([now_s - 0.01]))
            measured = JointStates(
                stamp_ns,
                (*names, finger),
                np.append(q[0], 0.014),
                np.append(v[0], 0.0),
                np.zeros(0),
            )
            writer.write(topics.YUMI_JOINT_STATES, messages.encode_joint_states(measured))
            depth = 0.012 if now_s > SUCCESS_S - 0.25 else 0.0
            scene = np.array([0.5 * now_s, depth])
            joints = ("lid_hinge", "button_slide")
            writer.write(
                topics.YUMI_SCENE_STATES,
                messages.encode_joint_states(
                    JointStates(stamp_ns, joints, scene, scene[:0], scene[:0])
                ),
            )
            if cycle % 5 == 0:
                for topic, names_, values in (
                    (topics.POLICY_OBSERVATION, LAYOUT.observation_names, [0.2, depth]),
                    (topics.POLICY_ACTION, ("vx", "vy", "vz"), [0.1, -0.2, 1.0]),
                ):
                    vector = np.array(values)
                    states = JointStates(stamp_ns, names_, vector, vector[:0], vector[:0])
                    writer.write(topic, messages.encode_joint_states(states))
            state = "executing" if cycle > 10 else "holding"
            status = Status(stamp_ns, "endpoint", messages.OK, state)
            writer.write(topics.YUMI_STATUS, messages.encode_status(status))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("replay") / "run.mcap"
    write_recording(path)
    return path


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
    assert rows["/events"] == 3


def test_scene_geometry_leaves_out_robot_and_floor_and_moves_as_mujoco_does():
    model = mujoco.MjModel.from_xml_string(SCENE)
    geometry = scene_geometry(model)
    assert SceneGeometry.from_json(geometry.to_json()) == geometry
    assert {part.name: part.joint for part in geometry.parts} == {
        "wall": "",
        "plate": "lid_hinge",
        "knob": "button_slide",
    }
    joints = {joint.name: joint for joint in geometry.joints}
    plate = next(part for part in geometry.parts if part.name == "plate")
    assert plate.colour == (0.0, 0.0, 1.0, 1.0)
    data = mujoco.MjData(model)
    data.joint("lid_hinge").qpos = 0.7
    mujoco.mj_kinematics(model, data)
    hinge = joints["lid_hinge"]
    offset = np.subtract(plate.position, hinge.anchor)
    axis = np.array(hinge.axis)
    turned = (
        np.cos(0.7) * offset
        + np.sin(0.7) * np.cross(axis, offset)
        + (1 - np.cos(0.7)) * axis * (axis @ offset)
    )
    np.testing.assert_allclose(np.add(hinge.anchor, turned), data.geom("plate").xpos, atol=1e-12)


def test_hinge_in_the_file_turns_about_its_axis(recorded, tmp_path):
    """Rerun's rotation and translation together put the plate where MuJoCo puts it."""
    out = tmp_path / "run.rrd"
    write_replay(recorded, out)
    found = [
        chunk.to_record_batch()
        for chunk in RrdReader(out).stream().to_chunks()
        if str(chunk.entity_path) == "/world/scene/lid_hinge" and not chunk.is_static
    ]
    table = {name: column for batch in found for name, column in batch.to_pydict().items()}
    translation = next(v for k, v in table.items() if "translation" in k)
    quaternion = next(v for k, v in table.items() if "quaternion" in k)
    model = mujoco.MjModel.from_xml_string(SCENE)
    geometry = scene_geometry(model)
    plate = next(part for part in geometry.parts if part.name == "plate")
    data = mujoco.MjData(model)
    for row in (0, len(translation) // 2, len(translation) - 1):
        data.joint("lid_hinge").qpos = 0.5 * row * 0.02
        mujoco.mj_kinematics(model, data)
        moved = np.empty(3)
        xyzw = np.array(quaternion[row][0])
        mujoco.mju_rotVecQuat(moved, np.array(plate.position), np.roll(xyzw, 1))
        np.testing.assert_allclose(moved + translation[row][0], data.geom("plate").xpos, atol=1e-6)


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
    with pytest.raises(ConfigurationError, match="no folder"):
        write_replay(other, tmp_path / "absent" / "out.rrd")


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
