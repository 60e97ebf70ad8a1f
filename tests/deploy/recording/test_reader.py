"""Recordings are read back whole or as far as they go, by us and by others."""

from __future__ import annotations

import struct
from random import Random

import pytest
import zstandard
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from recorded_states import states, write_file
from rosbags.typesys import Stores, get_typestore

from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.wire import ros2_keys, topics
from skewmi.errors import ConfigurationError

INT64 = st.integers(-(2**63), 2**63 - 1)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(odd=st.lists(st.tuples(st.binary(max_size=50), INT64, INT64), min_size=1, max_size=5))
@example([(b"", -1, -1)])
@example([(b"", 2**32, 0)])
@example([(b"", 2**63 - 1, -(2**63))])
def test_whatever_an_attachment_says_can_be_written(tmp_path, odd):
    """Numbers that MCAP's fields cannot hold used to end the recording and lose its last chunk."""
    path = tmp_path / "run.mcap"
    topic = topics.YUMI_JOINT_STATES
    with RecordingWriter(path) as writer:
        writer.write(topic, b"before", sequence=1)
        for payload, sequence, time_ns in odd:
            attachment = ros2_keys.encode_attachment(sequence, time_ns, bytes(16))
            sequence, time_ns, _ = ros2_keys.decode_attachment(attachment)
            writer.write(topic, payload, sequence=sequence, publish_time_ns=time_ns)
        writer.write(topic, b"after", sequence=2, log_time_ns=-1)
    recording = read_recording(path)
    assert recording.complete
    first, *between, last = recording.messages[topic.name]
    assert (first.payload, first.sequence, last.payload) == (b"before", 1, b"after")
    assert [(m.payload, m.sequence, m.publish_time_ns) for m in between] == [
        (payload, sequence % 2**32, max(0, time_ns)) for payload, sequence, time_ns in odd
    ]


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


EXTREMES = [*(2**bits - 1 for bits in (0, 1, 8, 31, 32, 63, 64)), 2**31, 2**63]


def damaged(data: bytes, random: Random) -> bytes:
    """A file after bytes were changed, put in, taken out or cut off, behind its first eight."""
    damage = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 4))):
        # Half of them in the first records, as most of the rest is compressed.
        last = len(damage) if random.random() < 0.5 else min(len(damage), 600)
        place = random.randrange(8, last)
        length = random.randrange(1, 40)
        match random.randrange(6):
            case 0:
                damage[place] = random.randrange(256)
            case 1:
                number = struct.pack("<Q", random.choice(EXTREMES))
                damage[place : place + 8] = number
            case 2:
                number = struct.pack("<I", random.choice(EXTREMES) % 2**32)
                damage[place : place + 4] = number
            case 3:
                del damage[place : place + length]
            case 4:
                damage[place:place] = random.randbytes(length)
            case 5:
                del damage[max(place, 9) :]
        if len(damage) < 10:
            break
    return bytes(damage)


def rewritten_chunks(data: bytes, random: Random) -> bytes:
    """A file whose first chunk was damaged inside, where its checksum (here none) is no help."""
    out, place = bytearray(data[:8]), 8
    done = False
    while place < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, place)
        content = data[place + 9 : place + 9 + length]
        place += 9 + length
        if opcode == 6 and not done:
            start, end, size, _, name = struct.unpack_from("<QQQII", content)
            assert content[32 : 32 + name] == b"zstd"
            inside = zstandard.decompress(content[40 + name :], size)
            inside = damaged(8 * b"-" + inside, random)[8:]
            packed = zstandard.compress(inside)
            content = struct.pack("<QQQII4sQ", start, end, len(inside), 0, 4, b"zstd", len(packed))
            content += packed
            done = True
        out += struct.pack("<BQ", opcode, len(content)) + content
    assert done
    return bytes(out + data[-8:])


def test_no_damage_to_a_recording_is_more_than_an_early_end(tmp_path):
    """What can be read of it is shown or it is refused; nothing else is raised."""
    path, mutant = tmp_path / "run.mcap", tmp_path / "mutant.mcap"
    write_file(path)
    data = path.read_bytes()
    random = Random(3)
    refused = early = 0
    for number in range(3000):
        mutant.write_bytes((damaged if number % 2 else rewritten_chunks)(data, random))
        try:
            early += not read_recording(mutant).complete
        except ConfigurationError:
            refused += 1
    # Else the mutations have missed their mark.
    assert refused > 300
    assert early > 100


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
