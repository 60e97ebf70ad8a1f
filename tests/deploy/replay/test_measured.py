"""Forces, torques, times and thresholds are drawn as recorded; what is missing is said."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from drawn import document, drawn, drawn_times, series_names
from recorded_motion import (
    CYCLE_NS,
    DURATION_S,
    EPOCH_NS,
    LAYOUT,
    Q_MIDDLE,
    SCENE,
    motion,
    write_recording,
)

from skewmi.contact import QUANTITIES
from skewmi.deploy.recording.reader import METADATA_NAME, read_recording, run_metadata
from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.replay.assembler import RunAssembler, understand
from skewmi.deploy.replay.data import Subject
from skewmi.deploy.replay.replay import write_replay
from skewmi.deploy.robot.backends.mujoco.scene_geometry import scene_geometry
from skewmi.deploy.wire import messages, topics
from skewmi.deploy.wire.messages import JointStates, Status
from skewmi.deploy.wire.simulation_status import CONTACT_FORCES, ContactForces, encode_forces
from skewmi.robot_models import frames, yumi
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import JointTrajectory, TrajectoryChunk

NAMES = yumi.joint_names("right")
CYCLES = 100
TORQUE = np.arange(7) - 3.0


def sent_ns(cycle: int, late_ms: float = 0.0) -> int:
    """Wall clock of a message, in a rhythm of 20 ms."""
    return 10**18 + cycle * CYCLE_NS + round(1e6 * late_ms)


def status(cycle: int) -> bytes:
    """A robot's, with the forces of the last ten cycles, some of them told twice."""
    stamps = EPOCH_NS + np.arange(max(0, cycle - 12), cycle) * CYCLE_NS
    hand = (stamps - EPOCH_NS) / CYCLE_NS
    values = {
        CONTACT_FORCES: encode_forces(ContactForces(stamps, hand, 2.0 * hand)),
        "slips": str(cycle // 50),
        "refused_of_commander": "3",
    }
    return messages.encode_status(
        Status(EPOCH_NS + cycle * CYCLE_NS, "skewmi_robot", 0, "holding", values)
    )


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Recording and replay of a robot that tells everything; every tenth command is late."""
    folder = tmp_path_factory.mktemp("measured")
    path, out = folder / "run.mcap", folder / "run.rrd"
    with RecordingWriter(path) as writer:
        writer.add_metadata(METADATA_NAME, run_metadata(layout_json=LAYOUT.to_json()))
        for cycle in range(CYCLES):
            stamp_ns = EPOCH_NS + cycle * CYCLE_NS
            q, v, _ = motion(np.array([cycle * 0.02]))
            states = JointStates(stamp_ns, NAMES, q[0], v[0], TORQUE * (1 + cycle))
            writer.write(
                topics.YUMI_JOINT_STATES,
                messages.encode_joint_states(states),
                publish_time_ns=sent_ns(cycle),
            )
            ahead = TrajectoryChunk.of(
                stamp_ns + 12_000_000, NAMES, JointTrajectory(*motion(cycle * 0.02 + np.arange(9)))
            )
            writer.write(
                topics.YUMI_TRAJECTORY,
                messages.encode_chunk(ahead),
                publish_time_ns=sent_ns(cycle, 22.0 if cycle % 10 == 5 else 4.0),
            )
            if cycle % 10 == 0:
                writer.write(topics.YUMI_STATUS, status(cycle))
    write_replay(path, out)
    return path, out


def test_torques_are_those_of_the_joint_states(measured: tuple[Path, Path]) -> None:
    torque = drawn(measured[1], "/joints/torque")
    np.testing.assert_allclose(torque, TORQUE * (1 + np.arange(CYCLES))[:, None])
    assert series_names(measured[1], "/joints/torque") == [
        f"joint {n}" for n in (1, 2, 7, 3, 4, 5, 6)
    ]


def test_each_cycles_forces_are_drawn_once_against_what_is_gentle(
    measured: tuple[Path, Path],
) -> None:
    force = drawn(measured[1], "/hand/force/contact")
    np.testing.assert_allclose(force, np.arange(90)[:, None] * (1.0, 2.0))
    np.testing.assert_allclose(
        drawn_times(measured[1], "/hand/force/contact"), 0.02 * np.arange(90), atol=1e-9
    )
    limit = QUANTITIES["hand_force_peak_n"].limit
    assert np.unique(drawn(measured[1], "/hand/force/limit")) == [limit]


def test_lateness_is_the_time_left_when_a_command_was_sent(measured: tuple[Path, Path]) -> None:
    """Commands are due 12 ms after their state; most are sent 4 ms after it, some 22 ms."""
    spare = drawn(measured[1], "/timing/spare/ms")[:, 0]
    expected = np.where(np.arange(CYCLES) % 10 == 5, 12.0 - 22.0, 12.0 - 4.0)
    np.testing.assert_allclose(spare, expected, atol=1e-6)
    between = drawn(measured[1], "/timing/intervals/joint_states/ms")[:, 0]
    np.testing.assert_allclose(between, np.full(CYCLES - 1, 20.0), atol=1e-6)
    assert np.unique(drawn(measured[1], "/timing/intervals/joint_states/meant")) == [20.0]
    counts = drawn(measured[1], "/timing/counts")
    np.testing.assert_array_equal(counts[:, 0], np.full(10, 3.0))
    np.testing.assert_array_equal(counts[:, 1], np.arange(0, CYCLES, 10) // 50)


@pytest.mark.parametrize("size", [1, 7, 64])
def test_times_and_forces_of_pieces_are_those_of_the_whole(
    measured: tuple[Path, Path], size: int
) -> None:
    """Looks in between, as a live view has them, change nothing."""
    recorded = read_recording(measured[0])
    ordered = sorted(
        ((m.publish_time_ns, t, m.payload) for t, ms in recorded.messages.items() for m in ms),
        key=lambda row: row[0],
    )
    assembler, pieces = RunAssembler(Subject(None, {}, None)), []
    for number, (when, topic, payload) in enumerate(ordered):
        assembler.feed(topic, payload, when)
        if number % size == 0:
            pieces.append(assembler.take())
    runs = [piece for piece in [*pieces, assembler.take(final=True)] if piece is not None]
    whole = understand(recorded)
    for get in (lambda run: run.spare, lambda run: run.forces, lambda run: run.torque):
        joined = np.concatenate([get(run).values.reshape(-1) for run in runs])
        np.testing.assert_allclose(joined, get(whole).values.reshape(-1))
    states = [
        run.intervals["joint states"].values for run in runs if "joint states" in run.intervals
    ]
    assert len(np.concatenate(states)) == CYCLES - 1


def test_hand_is_drawn_in_mm_between_the_edges_of_its_workspace(
    measured: tuple[Path, Path],
) -> None:
    q = motion(0.02 * np.arange(CYCLES))[0]
    position, rotation = ArmKinematics("right").forward(q)
    workspace = LAYOUT.workspace
    assert workspace is not None
    hand = drawn(measured[1], "/hand/measured/position")
    np.testing.assert_allclose(hand, 1e3 * (position + frames.BASE_IN_WORLD), atol=1e-9)
    edges = drawn(measured[1], "/hand/measured/workspace")
    np.testing.assert_allclose(edges[0], 1e3 * np.array([*workspace.low, *workspace.high]))
    hold = np.diag([1.0, -1.0, -1.0])  # the quaternion 0, 1, 0, 0: half a turn about x
    cosine = (np.trace(np.swapaxes(rotation, 1, 2) @ hold, axis1=1, axis2=2) - 1) / 2
    tilt = drawn(measured[1], "/hand/tilt/measured")[:, 0]
    np.testing.assert_allclose(tilt, np.degrees(np.arccos(np.clip(cosine, -1, 1))), atol=1e-6)
    assert np.unique(drawn(measured[1], "/hand/tilt/limit")) == [2.0]


def test_what_is_missing_is_said_and_not_drawn(tmp_path: Path, measured: tuple[Path, Path]) -> None:
    path, out = tmp_path / "bare.mcap", tmp_path / "bare.rrd"
    write_recording(path, metadata=False)
    write_replay(path, out)
    words = document(out, "/legend")
    for missing in (
        "joint torques: this robot measures none",
        "contact forces",
        "the scene's shapes",
        "limits of the joints",
        "the task's layout",
        "times of the robot's cycles",
    ):
        assert missing in words
    for entity in ("/joints/torque", "/hand/force/contact", "/hand/tilt/measured"):
        assert not len(drawn(out, entity))
    told = document(measured[1], "/legend")
    assert "joint torques" not in told
    assert "contact forces" not in told
    for color in ("orange", "blue", "green"):
        assert f"**{color}**" in told


def test_zeros_are_no_torques(tmp_path: Path) -> None:
    """As a robot sends them that measures none."""
    path, out = tmp_path / "zeros.mcap", tmp_path / "zeros.rrd"
    states = JointStates(EPOCH_NS, NAMES, Q_MIDDLE, np.zeros(7), np.zeros(7))
    with RecordingWriter(path) as writer:
        writer.write(topics.YUMI_JOINT_STATES, messages.encode_joint_states(states))
    write_replay(path, out)
    assert "joint torques: this robot measures none (it sends zeros)" in document(out, "/legend")


def test_thresholds_of_success_stand_beside_the_scenes_joints(tmp_path: Path) -> None:
    geometry = scene_geometry(
        mujoco.MjModel.from_xml_string(SCENE), {"button_slide": "button_depth"}
    )
    path, out = tmp_path / "run.mcap", tmp_path / "run.rrd"
    write_recording(path)
    content = {"scene": geometry.to_json()}
    recorded = read_recording(path)
    again = tmp_path / "again.mcap"
    with RecordingWriter(again) as writer:
        writer.add_metadata(METADATA_NAME, {**recorded.metadata, **content})
        by_name = {topic.name: topic for topic in topics.TOPICS}
        for name, rows in recorded.messages.items():
            for row in rows:
                writer.write(by_name[name], row.payload, publish_time_ns=row.publish_time_ns)
    write_replay(again, out)
    # The region is 10 to 20 mm, and the field ends at 20 mm.
    assert np.unique(drawn(out, "/scene_joints/button_slide/success")) == pytest.approx([10.0])
    depth = drawn(out, "/scene_joints/button_slide/value")[:, 0]
    assert depth[-1] == pytest.approx(12.0)
    lid = drawn(out, "/scene_joints/lid_hinge/value")[:, 0]
    last_s = DURATION_S - 0.02
    assert lid[-1] == pytest.approx(np.degrees(0.5 * last_s))
