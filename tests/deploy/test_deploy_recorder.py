"""Recordings: complete, in order, readable by others, and readable after any kill."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from skewmi.deploy.recording.reader import METADATA_NAME, read_recording, run_metadata
from skewmi.deploy.recording.recorder import Recorder
from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.wire import messages, topics
from skewmi.deploy.wire.messages import JointStates
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import ConfigurationError, TransportError

NAMES = ("a", "b")


def states(number: int) -> bytes:
    values = np.full(2, float(number))
    return messages.encode_joint_states(JointStates(number, NAMES, values, values, values))


@pytest.fixture
def config() -> TransportConfig:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return TransportConfig.for_endpoint(f"tcp/127.0.0.1:{probe.getsockname()[1]}")


def publish_until_recorded(link: Link, path: Path, at_least_bytes: int) -> int:
    """Publish until that much has reached the file; how many messages that took."""
    publisher = link.publisher(topics.YUMI_JOINT_STATES)
    deadline = time.monotonic() + 30.0
    while path.stat().st_size < at_least_bytes and time.monotonic() < deadline:
        publisher.put(states(publisher.sequence))
        time.sleep(0.0005)
    return publisher.sequence


def write_file(path: Path, count: int = 400) -> None:
    with RecordingWriter(path) as writer:
        writer.add_metadata(METADATA_NAME, run_metadata(task="none"))
        for number in range(count):
            writer.write(topics.YUMI_JOINT_STATES, states(number), sequence=number)


def test_recorder_writes_what_was_published(tmp_path, config):
    path = tmp_path / "run.mcap"
    with Link.open(config, "endpoint") as link:
        with Recorder(path, config, run_metadata(seed="3")) as recorder:
            sent = publish_until_recorded(link, path, 20_000)
            recorder.add_metadata({"outcome": "success"})
            summary = recorder.close()
        assert recorder.close() == summary
    recording = read_recording(path)
    assert recording.complete
    assert recording.metadata == {"seed": "3", "outcome": "success"}
    assert recording.types[topics.YUMI_JOINT_STATES.name] == topics.JOINT_STATE
    got = recording.messages[topics.YUMI_JOINT_STATES.name]
    first = got[0].sequence
    assert [message.sequence for message in got] == list(range(first, sent + 1))
    assert [message.payload for message in got] == [states(n - 1) for n in range(first, sent + 1)]
    assert summary.messages == len(got)
    assert summary.missed == 0
    assert summary.size_bytes == path.stat().st_size


def test_recording_survives_the_kill_of_its_recorder(tmp_path, config):
    path = tmp_path / "run.mcap"
    with Link.open(config, "endpoint") as link:
        recorder = Recorder(path, config, run_metadata(seed="3"))
        sent = publish_until_recorded(link, path, 20_000)
        os.kill(recorder._listener.process.pid, signal.SIGKILL)
        with pytest.raises(TransportError, match="stopped early"):
            recorder.close()
    recording = read_recording(path)
    assert not recording.complete
    assert recording.metadata == {"seed": "3"}
    got = [m.payload for m in recording.messages[topics.YUMI_JOINT_STATES.name]]
    # All but the last, unfinished chunk of 32 KiB.
    assert sent - len(got) < 32 * 1024 / len(states(0)) + 500
    assert len(got) > 100
    assert got == [states(messages.decode_joint_states(p).stamp_ns) for p in got]


def test_recording_is_finished_when_its_owner_is_killed(tmp_path, config):
    path = tmp_path / "run.mcap"
    code = f"""
import time
from pathlib import Path
from skewmi.deploy.recording.recorder import Recorder
from skewmi.deploy.wire.transport import TransportConfig
recorder = Recorder(Path({str(path)!r}), TransportConfig.for_client({config.listen[0]!r}))
print("recording", flush=True)
time.sleep(60)
"""
    with Link.open(config, "endpoint") as link:
        owner = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
        assert owner.stdout is not None
        assert owner.stdout.readline() == b"recording\n"
        publish_until_recorded(link, path, 20_000)
        owner.kill()
        owner.wait()
        deadline = time.monotonic() + 20.0
        while not (recording := read_recording(path)).complete:
            assert time.monotonic() < deadline, "the recorder did not finish the file"
            time.sleep(0.1)
    assert len(recording.messages[topics.YUMI_JOINT_STATES.name]) > 100


def test_other_readers_understand_the_file(tmp_path):
    path = tmp_path / "run.mcap"
    write_file(path, 5)
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        found = list(reader.iter_messages())
    store = get_typestore(Stores.ROS2_JAZZY)
    for number, (schema, channel, message) in enumerate(found):
        assert (schema.name, schema.encoding) == (topics.JOINT_STATE, "ros2msg")
        assert b"float64[] position" in schema.data
        assert (channel.topic, channel.message_encoding) == ("/yumi/joint_states", "cdr")
        assert store.deserialize_cdr(message.data, schema.name).position[0] == number
    assert len(found) == 5


def test_every_cut_of_a_recording_can_be_read(tmp_path):
    whole, cut = tmp_path / "whole.mcap", tmp_path / "cut.mcap"
    write_file(whole)
    data = whole.read_bytes()
    before = 0
    for length in range(0, len(data), max(1, len(data) // 150)):
        cut.write_bytes(data[:length])
        try:
            recording = read_recording(cut)
        except ConfigurationError:
            assert before == 0, "a longer file shows less"
            continue
        assert not recording.complete
        got = recording.messages[topics.YUMI_JOINT_STATES.name]
        assert [m.payload for m in got] == [states(n) for n in range(len(got))]
        assert len(got) >= before
        before = len(got)
    assert before > 200


@pytest.mark.parametrize(
    ("content", "complaint"),
    [(None, "no recording at"), (b"", "is empty"), (b"PK\x03\x04zip", "not an MCAP recording")],
)
def test_files_that_are_no_recordings_are_refused(tmp_path, content, complaint):
    path = tmp_path / "run.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigurationError, match=complaint):
        read_recording(path)


def test_recording_without_messages_is_refused(tmp_path):
    path = tmp_path / "run.mcap"
    with RecordingWriter(path):
        pass
    with pytest.raises(ConfigurationError, match="holds no message"):
        read_recording(path)


def test_recorder_refuses_before_it_starts(tmp_path, config):
    existing = tmp_path / "run.mcap"
    existing.write_bytes(b"precious")
    with pytest.raises(ConfigurationError, match="exists already"):
        Recorder(existing, config)
    assert existing.read_bytes() == b"precious"
    with pytest.raises(ConfigurationError, match="no folder"):
        Recorder(tmp_path / "absent" / "run.mcap", config)


def test_recorder_without_endpoint_says_so(tmp_path, config):
    client = TransportConfig.for_client(config.listen[0], connect_timeout_s=0.3)
    with pytest.raises(TransportError, match="no robot endpoint answers"):
        Recorder(tmp_path / "run.mcap", client)
