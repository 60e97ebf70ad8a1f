"""What is drawn as executed was executed, and the robot stands where it stands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_motion import CYCLE_NS, EPOCH_NS, GRID_NS, motion, write_recording
from rerun.chunk import RrdReader

from skewmi.deploy.replay.assembler import RunAssembler
from skewmi.deploy.replay.data import Subject
from skewmi.deploy.replay.replay import write_replay
from skewmi.deploy.wire import messages, topics
from skewmi.deploy.wire.messages import COMMANDER_REFUSED_STAMPS, JointStates, Status
from skewmi.robot_models import urdf, yumi
from skewmi.trajectory import JointTrajectory, TrajectoryChunk

NAMES = yumi.joint_names("right")
CYCLES = 12


def chunk(index: int, shift: float) -> TrajectoryChunk:
    """Forty samples of a known motion from the cycle `index` on, shifted."""
    time_s = (index * CYCLE_NS + np.arange(40) * GRID_NS) / 1e9
    q, v, a = motion(time_s)
    return TrajectoryChunk.of(EPOCH_NS + index * CYCLE_NS, NAMES, JointTrajectory(q + shift, v, a))


def refusal(stamps: list[int]) -> bytes:
    values = {COMMANDER_REFUSED_STAMPS: " ".join(map(str, stamps)), "refusal": "too fast"}
    return messages.encode_status(Status(EPOCH_NS, "skewmi_robot", 1, "executing", values))


def state(index: int) -> bytes:
    time_ns = index * CYCLE_NS
    nothing = np.zeros(7)
    q = motion(np.array([time_ns / 1e9]))[0][0]
    return messages.encode_joint_states(JointStates(EPOCH_NS + time_ns, NAMES, q, nothing, nothing))


@settings(max_examples=40, deadline=None)
@given(refused=st.sets(st.integers(1, CYCLES - 1)), live=st.booleans())
def test_refused_chunks_are_not_drawn(refused: set[int], live: bool) -> None:
    """The chunk before a refused one is followed on, as a brute-force robot does."""
    assembler = RunAssembler(Subject(None, {}, None))
    q, seen = [], []
    for index in range(CYCLES):
        sent = chunk(index, shift=float(index in refused))
        assembler.feed(topics.YUMI_TRAJECTORY.name, messages.encode_chunk(sent))
        if index in refused:
            assembler.feed(topics.YUMI_STATUS.name, refusal([sent.stamp_ns]))
        assembler.feed(topics.YUMI_JOINT_STATES.name, state(index - 2))
        if live:
            seen.append(assembler.take())
    seen.append(assembler.take(final=True))
    q = np.concatenate([run.commanded.q for run in seen if run is not None])
    taken = sorted(set(range(CYCLES)) - refused)
    ends = [5 * following for following in taken[1:]] + [5 * CYCLES + 40]
    ticks = [range(5 * i, min(end, 5 * i + 40)) for i, end in zip(taken, ends, strict=True)]
    expected_s = np.concatenate([np.array(ticks_of) for ticks_of in ticks]) * GRID_NS / 1e9
    np.testing.assert_allclose(q, motion(expected_s)[0], atol=1e-12)


def test_stamps_that_are_no_numbers_are_malformed() -> None:
    assembler = RunAssembler(Subject(None, {}, None))
    values = {COMMANDER_REFUSED_STAMPS: "12 x"}
    status = messages.encode_status(Status(EPOCH_NS, "skewmi_robot", 0, "holding", values))
    assembler.feed(topics.YUMI_STATUS.name, status)
    assert assembler.malformed == 1


def first_rows(path: Path, entity: str) -> list[dict[str, object]]:
    """Transforms of an entity as the file has them, static ones too."""
    parts = RrdReader(path).stream().to_chunks()
    return [p.to_record_batch().to_pydict() for p in parts if str(p.entity_path) == entity]


def test_the_left_arm_hangs_where_it_is_simulated_and_guarded(tmp_path: Path) -> None:
    recording = tmp_path / "run.mcap"
    write_recording(recording)
    out = tmp_path / "run.rrd"
    write_replay(recording, out)
    model = pinocchio.buildModelFromXML(urdf.build_urdf())
    data, q = model.createData(), pinocchio.neutral(model)
    for joint, value in zip(yumi.joint_names("left"), yumi.HOME["left"], strict=True):
        q[model.joints[model.getJointId(joint)].idx_q] = value
    pinocchio.forwardKinematics(model, data, q)
    for joint in yumi.joint_names("left"):
        rows = first_rows(out, f"/robot_measured/joints/{joint}")
        found = [v for row in rows for k, v in row.items() if "quaternion" in k.lower() and v[0]]
        assert found, f"{joint} is not turned"
        x, y, z, w = found[0][0][0]
        drawn = pinocchio.Quaternion(w, x, y, z).matrix()
        expected = data.liMi[model.getJointId(joint)].rotation
        np.testing.assert_allclose(drawn, expected, atol=1e-5)
