"""CDR of trajectory_msgs/JointTrajectory for points that all have the same shape.

A chunk of n points with d joints always has the same bytes but for stamp, times and numbers.
So the bytes are laid out once (by rosbags, the reference) and patched in place after that,
through a numpy view with one record per point. CDR aligns each number to its size, counted
from the end of the four-byte header, so a point is

    u32 d, [pad], d x f64,  u32 d, pad, d x f64,  u32 d, pad, d x f64,  u32 0,  i32 s, u32 ns

and occupies 24 d + 32 bytes, whether its first pad is there or not: the first point of a
message may begin on a multiple of eight and then has it, all others begin four bytes past one
and have not. Records therefore start at a point's first number; the next point's count is
their last field.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any

import numpy as np

from skewmi.deploy.wire import ros2_types
from skewmi.deploy.wire.topics import JOINT_TRAJECTORY
from skewmi.trajectory import JointTrajectory, TrajectoryChunk

_NS_PER_S = 1_000_000_000
_HEADER = b"\x00\x01\x00\x00"
_STAMP = struct.Struct("<iI")
_U32 = struct.Struct("<I")
_MOST_PADDING = 3
"""Bytes that may follow a message, so that its length is a multiple of four."""
MAX_JOINTS = 64
"""Names that are read."""


@lru_cache(maxsize=64)
def _record(joints: int) -> np.dtype[Any]:
    """One point, from its first position to the count of the next point's positions."""
    values = (np.dtype("<f8"), (joints,))
    return np.dtype(
        [
            ("q", *values),
            ("v_count", "<u4"),
            ("v_pad", "<u4"),
            ("v", *values),
            ("a_count", "<u4"),
            ("a_pad", "<u4"),
            ("a", *values),
            ("effort_count", "<u4"),
            ("sec", "<i4"),
            ("nanosec", "<u4"),
            ("q_count", "<u4"),
        ]
    )


@lru_cache(maxsize=256)
def _template(names: tuple[str, ...], count: int) -> tuple[bytearray, Any]:
    """A whole message with zeros in it, and the records inside it."""
    record = _record(len(names))
    if not (names and count):
        buffer = bytearray(_reference(names, count))
    else:
        # What stands before the first record is the same for any number of them but the number.
        one = _reference(names, 1)
        parsed = parse_names(one)
        assert parsed is not None
        buffer = bytearray(one[: len(one) + 4 - record.itemsize])
        _U32.pack_into(buffer, parsed[3] - 4, count)
        records = np.zeros(count, dtype=record)
        for name in ("v_count", "a_count", "q_count"):
            records[name] = len(names)
        buffer.extend(records.tobytes()[:-4])
    # The last record's q_count lies beyond the message: four spare bytes, never sent.
    start = len(buffer) + 4 - count * record.itemsize
    buffer.extend(b"\x00" * 4)
    return buffer, np.frombuffer(buffer, dtype=record, offset=start)


@lru_cache(maxsize=16)
def _reference(names: tuple[str, ...], count: int) -> bytes:
    """What rosbags makes of a trajectory at zero."""
    make = ros2_types.message_class
    zeros = np.zeros(len(names))
    point = make("trajectory_msgs/msg/JointTrajectoryPoint")(
        positions=zeros,
        velocities=zeros,
        accelerations=zeros,
        effort=np.zeros(0),
        time_from_start=make("builtin_interfaces/msg/Duration")(sec=0, nanosec=0),
    )
    stamp = make("builtin_interfaces/msg/Time")(sec=0, nanosec=0)
    message = make(JOINT_TRAJECTORY)(
        header=make("std_msgs/msg/Header")(stamp=stamp, frame_id=""),
        joint_names=list(names),
        points=[point] * count,
    )
    return ros2_types.encode(message, JOINT_TRAJECTORY)


def encode(chunk: TrajectoryChunk) -> bytes:
    """Bytes of a chunk whose shapes agree. Not thread-safe: the template is shared."""
    names, times_ns, samples = chunk.joint_names, chunk.time_from_start_ns, chunk.trajectory
    buffer, records = _template(names, len(samples))
    _STAMP.pack_into(buffer, 4, *divmod(int(chunk.stamp_ns), _NS_PER_S))
    if len(samples) and names:
        records["q"] = samples.q
        records["v"] = samples.v
        records["a"] = samples.a
    if len(samples):
        seconds = times_ns // _NS_PER_S
        records["sec"] = seconds
        records["nanosec"] = times_ns - seconds * _NS_PER_S
    return bytes(memoryview(buffer)[:-4])


def decode(payload: bytes) -> TrajectoryChunk | None:
    """A chunk, or None if the bytes are not of this regular shape."""
    parsed = parse_names(payload)
    if parsed is None:
        return None
    stamp_ns, names, count, start = parsed
    joints = len(names)
    if not 0 < joints <= MAX_JOINTS or count < 1:
        return None
    record = _record(joints)
    first = start + 4 + (4 if (start - 4) % 8 == 0 else 0)
    if len(payload) + 4 - first != count * record.itemsize:
        return None
    if _U32.unpack_from(payload, start)[0] != joints:
        return None
    records = np.frombuffer(payload + b"\x00" * 4, dtype=record, offset=first)
    counts_agree = (
        (records["v_count"] == joints).all()
        and (records["a_count"] == joints).all()
        and (records["effort_count"] == 0).all()
        and (records["q_count"][:-1] == joints).all()
    )
    if not counts_agree:
        return None
    times = records["sec"].astype(np.int64) * _NS_PER_S + records["nanosec"]
    q, v, a = (np.ascontiguousarray(records[name], dtype=np.float64) for name in "qva")
    return TrajectoryChunk(stamp_ns, names, times, JointTrajectory(q, v, a))


def decode_pointwise(payload: bytes, most_points: int) -> TrajectoryChunk:
    """A chunk whose points may have efforts, of any lengths, which are left out.

    rosbags takes some 40 us for a point, this 2 us.

    Args:
        payload: Any bytes.
        most_points: That are read.

    Raises:
        ValueError, struct.error: Not a JointTrajectory, or one whose points have not all positions,
            velocities and accelerations for every joint, or too many joints or points.
    """
    parsed = parse_names(payload)
    if parsed is None:
        raise ValueError(f"no names that can be read, of at most {MAX_JOINTS} joints")
    stamp_ns, names, count, position = parsed
    if count > most_points:
        raise ValueError(f"{count} points of different forms; at most {most_points} are read")
    joints = len(names)
    times = np.empty(count, dtype=np.int64)
    values: tuple[list[bytes], ...] = ([], [], [], [])
    for index in range(count):
        lengths = []
        for part in values:
            (length,) = _U32.unpack_from(payload, position)
            position += 4
            if length:
                position += (4 - position) % 8
            part.append(payload[position : position + 8 * length])
            position += 8 * length
            lengths.append(length)
        if lengths[:3] != [joints, joints, joints]:
            raise ValueError(
                f"trajectory point {index} has {tuple(lengths[:3])} positions, velocities, "
                f"accelerations; each must be {joints}, one per joint"
            )
        sec, nanosec = _STAMP.unpack_from(payload, position)
        position += _STAMP.size
        times[index] = sec * _NS_PER_S + nanosec
    if not position <= len(payload) <= position + _MOST_PADDING:
        raise ValueError(f"its contents have {position} bytes")
    q, v, a = (
        np.frombuffer(b"".join(part), dtype="<f8").astype(np.float64).reshape(count, joints)
        for part in values[:3]
    )
    return TrajectoryChunk(stamp_ns, names, times, JointTrajectory(q, v, a))


def parse_names(payload: bytes) -> tuple[int, tuple[str, ...], int, int] | None:
    """Stamp, joint names, number of points and where they start; None if anything is odd."""
    try:
        if payload[:4] != _HEADER:
            return None
        sec, nanosec = _STAMP.unpack_from(payload, 4)
        position = 12
        position += 4 + _U32.unpack_from(payload, position)[0]
        position += -position % 4
        (joints,) = _U32.unpack_from(payload, position)
        position += 4
        if joints > MAX_JOINTS:
            return None
        names = []
        for _ in range(joints):
            (length,) = _U32.unpack_from(payload, position)
            position += 4
            text = payload[position : position + length]
            if length < 1 or len(text) != length or text[-1] != 0:
                return None
            names.append(text[:-1].decode())
            position += length + -(position + length) % 4
        (count,) = _U32.unpack_from(payload, position)
        return sec * _NS_PER_S + nanosec, tuple(names), count, position + 4
    except (struct.error, UnicodeDecodeError):
        return None
