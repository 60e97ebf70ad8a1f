"""Recorders: what they write, and what becomes of it when somebody is killed."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
import zenoh
from recorded_states import states

from skewmi.deploy.recording.reader import read_recording, run_metadata
from skewmi.deploy.recording.recorder import Recorder
from skewmi.deploy.wire import messages, ros2_keys, topics
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import ConfigurationError, TransportError


@pytest.fixture
def config() -> TransportConfig:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return TransportConfig.for_robot(f"tcp/127.0.0.1:{probe.getsockname()[1]}")


def publish_until_recorded(link: Link, path: Path, at_least_bytes: int) -> int:
    """Publish until that much has reached the file; how many messages that took."""
    publisher = link.publisher(topics.YUMI_JOINT_STATES)
    deadline = time.monotonic() + 30.0
    while path.stat().st_size < at_least_bytes and time.monotonic() < deadline:
        publisher.put(states(publisher.sequence))
        time.sleep(0.0005)
    return publisher.sequence


def test_recorder_writes_what_was_published(tmp_path, config):
    path = tmp_path / "run.mcap"
    with Link.open(config, "endpoint") as link:
        with Recorder.start(path, config, run_metadata(seed="3")) as recorder:
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


def test_no_odd_message_ends_a_recording(tmp_path, config):
    path = tmp_path / "run.mcap"
    odd = [
        (payload, ros2_keys.encode_attachment(sequence, time_ns, bytes(16)))
        for payload in (b"", b"garbage", bytes(100_000))
        for sequence in (0, -1, 2**32, 2**63 - 1, -(2**63))
        for time_ns in (0, -1, 2**63 - 1, -(2**63))
    ]
    stranger = TransportConfig.for_client(config.listen[0])
    with (
        Link.open(config, "endpoint") as link,
        zenoh.open(stranger.zenoh()) as session,
        Recorder.start(path, config) as recorder,
    ):
        for topic in topics.TOPICS:
            key = ros2_keys.data_key(0, topic)
            session.put(key, b"no attachment")
            session.put(key, b"a short one", attachment=b"1234")
            for payload, attachment in odd:
                session.put(key, payload, attachment=attachment)
                time.sleep(0.001)
        time.sleep(1.0)
        sent = publish_until_recorded(link, path, path.stat().st_size + 20_000)
        summary = recorder.close()
    recording = read_recording(path)
    assert recording.complete
    got = recording.messages[topics.YUMI_JOINT_STATES.name]
    assert got[-1].payload == states(sent - 1)
    # What cannot be passed on at once is dropped; most of it arrives.
    assert len(recording.messages[topics.YUMI_STATUS.name]) > 30
    assert summary.messages == sum(map(len, recording.messages.values()))


def test_recording_survives_the_kill_of_its_recorder(tmp_path, config):
    path = tmp_path / "run.mcap"
    with Link.open(config, "endpoint") as link:
        recorder = Recorder.start(path, config, run_metadata(seed="3"))
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
recorder = Recorder.start(Path({str(path)!r}), TransportConfig.for_client({config.listen[0]!r}))
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


def test_recorder_refuses_before_it_starts(tmp_path, config):
    existing = tmp_path / "run.mcap"
    existing.write_bytes(b"precious")
    with pytest.raises(ConfigurationError, match="exists; give another"):
        Recorder.start(existing, config)
    assert existing.read_bytes() == b"precious"
    with pytest.raises(ConfigurationError, match="is a folder"):
        Recorder.start(tmp_path, config)
    with pytest.raises(ConfigurationError, match="is a file"):
        Recorder.start(existing / "run.mcap", config)


def test_recorder_without_robot_server_says_so(tmp_path, config):
    client = TransportConfig.for_client(config.listen[0], connect_timeout_s=0.3)
    with pytest.raises(TransportError, match="no robot server answers"):
        Recorder.start(tmp_path / "run.mcap", client)
