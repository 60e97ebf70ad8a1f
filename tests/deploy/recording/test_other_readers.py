"""Recordings are opened by others: rosbags' reader of bags, and Rerun's importer."""

from __future__ import annotations

import subprocess
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from skewmi.deploy.recording.reader import METADATA_NAME, run_metadata
from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.replay.viewer import executable
from skewmi.deploy.wire import messages, topics
from skewmi.deploy.wire.controller_state import ControllerState, encode_controller_state
from skewmi.deploy.wire.messages import JointStates, Status
from skewmi.robot_models import yumi
from skewmi.sim import tasks
from skewmi.trajectory import JointPoint, JointTrajectory, TrajectoryChunk

ROUNDS = 3


def payload(topic: topics.Topic, stamp_ns: int) -> bytes:
    """A message of the topic's type."""
    names, numbers = yumi.joint_names("right"), np.arange(7.0)
    if topic.type_name == topics.JOINT_TRAJECTORY:
        resting = JointTrajectory.resting(numbers, 50)
        return messages.encode_chunk(TrajectoryChunk.of(stamp_ns, names, resting))
    if topic.type_name == topics.CONTROLLER_STATE:
        point = JointPoint(numbers, numbers, numbers)
        return encode_controller_state(
            ControllerState(stamp_ns, names, point, numbers, numbers, numbers)
        )
    if topic.type_name == topics.DIAGNOSTIC_ARRAY:
        return messages.encode_status(Status(stamp_ns, "a", messages.OK, "b", {"c": "d"}))
    return messages.encode_joint_states(JointStates(stamp_ns, names, numbers, numbers, numbers))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every topic, as `skewmi deploy --record` writes them."""
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    layout = tasks.layout(tasks.default())
    with RecordingWriter(path) as writer:
        writer.add_metadata(METADATA_NAME, run_metadata(layout_json=layout.to_json()))
        for sequence in range(ROUNDS):
            for number, topic in enumerate(topics.TOPICS):
                # Session and robot server share a topic: senders have channels of their own.
                sender = bytes([sequence % 2, number] * 8)
                message = payload(topic, 10**9 * sequence)
                writer.write(topic, message, sequence=sequence, sender=sender)
    return path


def test_rosbags_reads_every_message(recording: Path) -> None:
    counts: Counter[str] = Counter()
    with AnyReader([recording]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            assert message.header.stamp.sec == counts[connection.topic]
            counts[connection.topic] += 1
    assert counts == {topic.name: ROUNDS for topic in topics.TOPICS}


def test_reruns_importer_finds_every_topic(recording: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun_cli", reason="comes with the extra 'view'")
    rerun, out = str(executable()), str(tmp_path / "run.rrd")
    subprocess.run([rerun, "mcap", "convert", str(recording), "-o", out], check=True, timeout=120)
    told = subprocess.run(
        [rerun, "rrd", "stats", out], check=True, timeout=120, capture_output=True, text=True
    )
    for topic in topics.TOPICS:
        assert f"{topic.name}: " in told.stdout, topic.name
