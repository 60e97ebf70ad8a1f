"""Recordings of several senders: what is recorded, what of it is believed, and what is said."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest
from link_peers import eventually
from recorded_states import states

from skewmi.deploy.recording.believed import believed_part
from skewmi.deploy.recording.reader import (
    BELIEVED,
    METADATA_NAME,
    STRANGERS,
    RecordedMessage,
    read_recording,
)
from skewmi.deploy.recording.recorder import Recorder
from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import Link, TransportConfig

JOINTS = topics.YUMI_JOINT_STATES


def test_recorder_takes_in_believed_senders_alone_also_new_ones(tmp_path: Path) -> None:
    """As when the robot server is restarted: its publishers are others then."""
    path = tmp_path / "run.mcap"
    config = TransportConfig.for_robot(f"tcp/127.0.0.1:{free_port()}")
    with Link.open(config, "endpoint") as link:
        first, second, third = (link.publisher(JOINTS) for _ in range(3))
        recorder = Recorder.start(path, config, believed={JOINTS.name: [first.gid.hex()]})

        def put_all() -> bool:
            for publisher in (first, second, third):
                publisher.put(states(publisher.sequence))
            return first.sequence > 200

        eventually(put_all, 20.0)
        recorder.believe({JOINTS.name: [second.gid.hex()]})
        eventually(lambda: put_all() and first.sequence > 400, 20.0)
        summary = recorder.close()
    recording = read_recording(path)
    senders = [message.sender for message in recording.messages[JOINTS.name]]
    assert set(senders) == {first.gid.hex(), second.gid.hex()}
    switch = senders.index(second.gid.hex())
    assert set(senders[:switch]) == {first.gid.hex()}
    assert set(senders[switch:]) == {second.gid.hex()}
    assert json.loads(recording.metadata[BELIEVED]) == {
        JOINTS.name: [first.gid.hex(), second.gid.hex()]
    }
    assert {s.gid for s in summary.strangers} == {third.gid.hex()}
    assert json.loads(recording.metadata[STRANGERS])[0]["node"] == "endpoint"
    believed = believed_part(recording)
    assert len(believed.recording.messages[JOINTS.name]) == summary.messages
    (note,) = believed.notes
    assert f"not recorded, as not believed: {JOINTS.name}: {third.gid.hex()[:8]}" in note


def written(path: Path, rng: random.Random, believed: object) -> dict[str, list[tuple[str, int]]]:
    """A file of five senders on each topic in any order; sender and number of each message."""
    content: dict[str, list[tuple[str, int]]] = {topic.name: [] for topic in topics.TOPICS}
    with RecordingWriter(path) as writer:
        if believed is not None:
            writer.add_metadata(METADATA_NAME, {BELIEVED: json.dumps(believed)})
        for number in range(400):
            topic, who = rng.choice(topics.TOPICS), rng.randrange(5)
            sender = bytes([who]) * 16 if who else b""
            writer.write(topic, states(number), sequence=number, sender=sender)
            content[topic.name].append((sender.hex(), number))
    return content


@pytest.mark.parametrize("seed", range(10))
def test_exactly_believed_senders_are_shown_and_the_rest_is_counted(
    tmp_path: Path, seed: int
) -> None:
    rng = random.Random(seed)
    ids = [bytes([who]).hex() * 16 for who in range(1, 5)]
    believed = {topic.name: rng.sample(ids, rng.randrange(4)) for topic in topics.TOPICS[1:]}
    content = written(tmp_path / "run.mcap", rng, believed)
    part = believed_part(read_recording(tmp_path / "run.mcap"))
    left_out = 0
    for topic, messages in content.items():
        known = believed.get(topic, [])
        shown = part.recording.messages.get(topic, [])
        assert [(m.sender, m.sequence) for m in shown] == [m for m in messages if m[0] in known]
        left_out += len(messages) - len(shown)
    assert sum(int(note.split(": ")[1].split()[0]) for note in part.notes) == left_out
    assert all(note.startswith("left out, as not believed: ") for note in part.notes)


@pytest.mark.parametrize("told", [None, 7, []], ids=["nothing", "number", "list"])
def test_file_that_does_not_tell_whom_to_believe_is_shown_whole_with_a_word(
    tmp_path: Path, told: object
) -> None:
    content = written(tmp_path / "run.mcap", random.Random(1), told)
    part = believed_part(read_recording(tmp_path / "run.mcap"))
    assert {topic: len(m) for topic, m in part.recording.messages.items()} == {
        topic: len(m) for topic, m in content.items()
    }
    assert len(part.notes) == len(topics.TOPICS)
    assert all("does not tell which of them to believe" in note for note in part.notes)


def test_odd_metadata_does_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path) as writer:
        odd = {BELIEVED: '{"/yumi/joint_states": 5}', STRANGERS: '[{"no": "stranger"}]'}
        writer.add_metadata(METADATA_NAME, odd)
        writer.write(JOINTS, states(1), sender=bytes(16))
    part = believed_part(read_recording(path))
    assert part.recording.messages[JOINTS.name] == []
    assert isinstance(read_recording(path).messages[JOINTS.name][0], RecordedMessage)
