"""Messages: our bytes are rosbags' bytes, and no bytes can do more than raise TransportError."""

from __future__ import annotations

import contextlib
import struct
from dataclasses import replace

import flood_senders
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.wire import chunk_codec, messages, ros2_types, topics
from skewmi.deploy.wire.messages import JointStates, Status, TriggerReply
from skewmi.errors import TransportError
from skewmi.trajectory import JointTrajectory, TrajectoryChunk

NAMES = tuple(f"yumi_joint_{i}_r" for i in (1, 2, 7, 3, 4, 5, 6))
STAMPS = st.integers(0, 2**31 * 10**9 - 1)


def make_chunk(
    samples: int, joint_names: tuple[str, ...] = NAMES, stamp_ns: int = 5_123_456_789, seed: int = 0
) -> TrajectoryChunk:
    q, v, a = np.random.default_rng(seed).standard_normal((3, samples, len(joint_names)))
    times = np.arange(samples, dtype=np.int64) * 4_000_000
    return TrajectoryChunk(stamp_ns, joint_names, times, JointTrajectory(q, v, a))


def rosbags_bytes(chunk: TrajectoryChunk) -> bytes:
    """The same message, made without our codec."""
    make = ros2_types.message_class
    points = [
        make("trajectory_msgs/msg/JointTrajectoryPoint")(
            positions=chunk.trajectory.q[i].copy(),
            velocities=chunk.trajectory.v[i].copy(),
            accelerations=chunk.trajectory.a[i].copy(),
            effort=np.zeros(0),
            time_from_start=make("builtin_interfaces/msg/Duration")(
                sec=int(t) // 10**9, nanosec=int(t) % 10**9
            ),
        )
        for i, t in enumerate(chunk.time_from_start_ns)
    ]
    sec, nanosec = divmod(chunk.stamp_ns, 10**9)
    stamp = make("builtin_interfaces/msg/Time")(sec=sec, nanosec=nanosec)
    header = make("std_msgs/msg/Header")(stamp=stamp, frame_id="")
    message = make(topics.JOINT_TRAJECTORY)(
        header=header, joint_names=list(chunk.joint_names), points=points
    )
    return ros2_types.encode(message, topics.JOINT_TRAJECTORY)


@given(
    samples=st.integers(0, 12),
    names=st.lists(st.text("abc_é", min_size=0, max_size=9), min_size=1, max_size=9),
    stamp_ns=STAMPS,
    seed=st.integers(0, 100),
)
@settings(max_examples=60, deadline=None)
def test_chunk_bytes_are_those_of_rosbags(samples, names, stamp_ns, seed):
    chunk = make_chunk(samples, tuple(names), stamp_ns, seed)
    payload = messages.encode_chunk(chunk)
    assert payload == rosbags_bytes(chunk)
    decoded = messages.decode_chunk(payload)
    assert decoded.stamp_ns == chunk.stamp_ns
    assert decoded.joint_names == chunk.joint_names
    np.testing.assert_array_equal(decoded.time_from_start_ns, chunk.time_from_start_ns)
    for name in "qva":
        np.testing.assert_array_equal(
            getattr(decoded.trajectory, name), getattr(chunk.trajectory, name)
        )


def test_successive_chunks_do_not_share_memory():
    first = make_chunk(5, seed=1)
    payload = messages.encode_chunk(first)
    decoded = messages.decode_chunk(payload)
    messages.encode_chunk(make_chunk(5, seed=2))
    assert payload == rosbags_bytes(first)
    np.testing.assert_array_equal(decoded.trajectory.q, first.trajectory.q)


def test_chunk_from_another_node_with_effort_and_frame_is_read():
    chunk = make_chunk(3)
    message = ros2_types.decode(rosbags_bytes(chunk), topics.JOINT_TRAJECTORY)
    message.header.frame_id = "base"
    message.points[1].effort = np.ones(7)
    payload = ros2_types.encode(message, topics.JOINT_TRAJECTORY)
    np.testing.assert_array_equal(messages.decode_chunk(payload).trajectory.v, chunk.trajectory.v)


@settings(max_examples=60, deadline=None)
@given(
    efforts=st.lists(st.integers(0, 9), max_size=12),
    joints=st.integers(1, 7),
    frame=st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=9),
    cut=st.integers(0, 400),
)
def test_points_of_different_forms_are_read_as_by_rosbags(efforts, joints, frame, cut):
    chunk = make_chunk(len(efforts), tuple(NAMES[:joints]))
    message = ros2_types.decode(rosbags_bytes(chunk), topics.JOINT_TRAJECTORY)
    message.header.frame_id = frame
    for point, effort in zip(message.points, efforts, strict=True):
        point.effort = np.ones(effort)
    payload = ros2_types.encode(message, topics.JOINT_TRAJECTORY)
    decoded = chunk_codec.decode_pointwise(payload, 12)
    assert decoded.joint_names == chunk.joint_names
    np.testing.assert_array_equal(decoded.time_from_start_ns, chunk.time_from_start_ns)
    for name in "qva":
        np.testing.assert_array_equal(
            getattr(decoded.trajectory, name), getattr(chunk.trajectory, name)
        )
    short = payload[: max(0, len(payload) - 1 - cut)]
    with pytest.raises(messages.MALFORMED):
        chunk_codec.decode_pointwise(short, 12)
    with pytest.raises(messages.MALFORMED):
        chunk_codec.decode_pointwise(payload + bytes(4), 12)


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (flood_senders.many_points(), "points of different forms; at most 500 are read"),
        (flood_senders.many_names(), "no names that can be read, of at most 64 joints"),
        (flood_senders.odd_points(501), "501 points of different forms; at most 500 are read"),
    ],
)
def test_what_would_take_long_to_read_is_refused_unread(monkeypatch, payload, words):
    monkeypatch.setattr(ros2_types, "decode", None)
    with pytest.raises(TransportError, match=words):
        messages.decode_chunk(payload)


def test_the_longest_trajectory_of_odd_points_is_read():
    payload = flood_senders.odd_points(500)
    assert messages.decode_chunk(payload).trajectory.q.shape == (500, 7)


def test_a_refusal_of_nonsense_says_what_is_wrong():
    """Some of what rosbags raises has no words."""
    with pytest.raises(TransportError) as raised:
        messages.decode_joint_states(b"")
    assert not str(raised.value).rstrip().endswith(":")


def test_big_endian_chunk_is_read_right_or_refused():
    chunk = make_chunk(3)
    swapped = b"\x00\x00" + messages.encode_chunk(chunk)[2:]
    with pytest.raises(TransportError):
        messages.decode_chunk(swapped)


def test_chunk_with_a_point_that_lacks_accelerations_is_refused():
    message = ros2_types.decode(rosbags_bytes(make_chunk(3)), topics.JOINT_TRAJECTORY)
    message.points[2].accelerations = np.zeros(0)
    payload = ros2_types.encode(message, topics.JOINT_TRAJECTORY)
    with pytest.raises(TransportError, match="point 2"):
        messages.decode_chunk(payload)


def test_encoding_of_shapes_that_disagree_is_refused():
    chunk = make_chunk(4)
    wrong = replace(chunk, trajectory=chunk.trajectory.part(slice(0, 3)))
    with pytest.raises(TransportError, match=r"\(4, 7\)"):
        messages.encode_chunk(wrong)
    with pytest.raises(TransportError, match="velocity"):
        messages.encode_joint_states(JointStates(0, NAMES, np.zeros(7), np.zeros(3), np.zeros(0)))


@given(stamp_ns=STAMPS, count=st.integers(0, 9), has_velocity=st.booleans(), seed=st.integers(0, 9))
@settings(max_examples=30, deadline=None)
def test_joint_states_survive_the_round_trip(stamp_ns, count, has_velocity, seed):
    position, velocity, effort = np.random.default_rng(seed).standard_normal((3, count))
    names = tuple(f"joint_{i}" for i in range(count))
    sent = JointStates(stamp_ns, names, position, velocity if has_velocity else effort[:0], effort)
    got = messages.decode_joint_states(messages.encode_joint_states(sent))
    assert (got.stamp_ns, got.names) == (sent.stamp_ns, sent.names)
    for name in ("position", "velocity", "effort"):
        np.testing.assert_array_equal(getattr(got, name), getattr(sent, name))


@given(
    text=st.text(st.characters(exclude_characters="\x00", exclude_categories=("Cs",))),
    level=st.sampled_from((messages.OK, messages.WARN, messages.ERROR)),
)
@settings(max_examples=30, deadline=None)
def test_status_and_reply_survive_the_round_trip(text, level):
    status = Status(7, "endpoint", level, text, {"reason": text, "": "empty key"})
    assert messages.decode_status(messages.encode_status(status)) == status
    reply = TriggerReply(bool(level), text)
    assert messages.decode_trigger_reply(messages.encode_trigger_reply(reply)) == reply
    assert messages.decode_trigger_request(messages.encode_trigger_request(text.encode())) == (
        text.encode()
    )


def test_trigger_bytes_are_those_of_cdr():
    assert messages.encode_trigger_request() == bytes.fromhex("0001000000")
    reply = messages.encode_trigger_reply(TriggerReply(True, "ok"))
    assert reply == bytes.fromhex("000100000100000003000000") + b"ok\x00"


DECODERS = {
    "chunk": (messages.decode_chunk, messages.encode_chunk(make_chunk(4))),
    "joint_states": (
        messages.decode_joint_states,
        messages.encode_joint_states(JointStates(1, NAMES, *np.zeros((3, 7)))),
    ),
    "status": (
        messages.decode_status,
        messages.encode_status(Status(1, "endpoint", 0, "holding", {"a": "b"})),
    ),
    "reply": (
        messages.decode_trigger_reply,
        messages.encode_trigger_reply(TriggerReply(True, "armed")),
    ),
    "request": (messages.decode_trigger_request, messages.encode_trigger_request(b"x")),
}


@pytest.mark.parametrize("kind", DECODERS)
@given(data=st.data())
@settings(max_examples=150, deadline=None)
def test_no_bytes_raise_anything_but_transport_error(kind, data):
    decode, valid = DECODERS[kind]
    way = data.draw(st.sampled_from(("truncate", "overwrite", "length", "noise")))
    if way == "truncate":
        payload = valid[: data.draw(st.integers(0, len(valid)))]
    elif way == "noise":
        payload = data.draw(st.binary(max_size=200))
    else:
        at = data.draw(st.integers(0, max(0, len(valid) - 4)))
        patch = (
            struct.pack("<I", data.draw(st.sampled_from((2**32 - 1, 2**31, 2**29, 2**20, 0))))
            if way == "length"
            else data.draw(st.binary(min_size=1, max_size=9))
        )
        payload = valid[:at] + patch + valid[at + len(patch) :]
    with contextlib.suppress(TransportError):
        decode(payload)


@pytest.mark.parametrize("kind", ["chunk", "joint_states", "status", "reply"])
def test_truncated_messages_are_refused(kind):
    decode, valid = DECODERS[kind]
    for length in range(len(valid) - 1):
        with pytest.raises(TransportError):
            decode(valid[:length])


def test_nan_in_a_chunk_reaches_the_checks_that_refuse_it():
    chunk = make_chunk(3)
    chunk.trajectory.q[1, 2] = np.nan
    assert np.isnan(messages.decode_chunk(messages.encode_chunk(chunk)).trajectory.q[1, 2])


@given(STAMPS, st.binary(max_size=40))
def test_a_stamp_is_read_without_the_rest(stamp_ns: int, rest: bytes) -> None:
    payload = messages.encode_chunk(make_chunk(3, stamp_ns=stamp_ns))
    assert messages.peek_stamp_ns(payload) == stamp_ns
    assert messages.peek_stamp_ns(payload[:12] + rest) == stamp_ns
    for broken in (payload[:11], b"", rest[:3], b"\x00\x00" + payload[2:]):
        assert messages.peek_stamp_ns(broken) is None
