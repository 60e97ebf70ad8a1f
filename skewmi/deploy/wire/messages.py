"""The messages of the wire: numpy on our side, ROS 2 messages in CDR on the other.

Bytes are what any ROS 2 node of the same type reads and writes: little-endian CDR behind the
four-byte header 00 01 00 00. Types and layouts come from rosbags' ROS 2 type definitions;
the trajectory, which is encoded every planner cycle, has its own codec in `chunk_codec`.

Decoding trusts nobody: whatever the bytes are, the result is a message or a TransportError.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from rosbags.serde.errors import SerdeError

from skewmi.deploy.wire import chunk_codec, ros2_types
from skewmi.deploy.wire.topics import DIAGNOSTIC_ARRAY, JOINT_STATE, JOINT_TRAJECTORY
from skewmi.errors import TransportError
from skewmi.trajectory import Array, TrajectoryChunk

_Message = TypeVar("_Message")

OK, WARN, ERROR = 0, 1, 2
"""Levels of a `Status`, as in diagnostic_msgs/DiagnosticStatus."""

MAX_IRREGULAR_POINTS = 500
"""Points that a trajectory may have unless all are of one form: it is read one by one."""

HARDWARE_ID = "yumi"
_CDR_HEADER = b"\x00\x01\x00\x00"
_NS_PER_S = 1_000_000_000

MALFORMED = (SerdeError, struct.error, ValueError, IndexError, OverflowError, AssertionError)
"""What decoding hostile bytes can raise inside rosbags and numpy (UnicodeDecodeError included)."""


@dataclass(frozen=True)
class JointStates:
    """Named joint values; velocity and effort may be empty."""

    stamp_ns: int
    names: tuple[str, ...]
    position: Array
    """rad, or m for slides. Shape (n,)."""
    velocity: Array
    """rad/s or m/s. Shape (n,) or (0,)."""
    effort: Array
    """N m or N. Shape (n,) or (0,)."""


@dataclass(frozen=True)
class Status:
    """State of one part of the system and why it is in it."""

    stamp_ns: int
    name: str
    level: int
    message: str
    values: dict[str, str] = field(default_factory=dict)


COMMANDER_REFUSED_STAMPS = "commander_refused_stamps_ns"
"""Value of a robot server's status: stamps of the chunks of the arm's commander that it has refused
since the last status, and so does not execute; decimal, with spaces between."""


def refused_stamps(status: Status) -> tuple[int, ...]:
    """Stamps of refused chunks of the commander's, ns; see `COMMANDER_REFUSED_STAMPS`.

    Raises:
        TransportError: They are no numbers.
    """
    text = status.values.get(COMMANDER_REFUSED_STAMPS, "")
    try:
        return tuple(int(stamp) for stamp in text.split())
    except ValueError as error:
        raise TransportError(f"stamps of refused chunks cannot be read: {error}") from error


@dataclass(frozen=True)
class TriggerReply:
    """Answer of a service."""

    success: bool
    message: str
    replier: str = field(default="", compare=False, repr=False)
    """Zenoh id of the session that answered, where Zenoh tells it."""


def encode_chunk(chunk: TrajectoryChunk) -> bytes:
    """trajectory_msgs/JointTrajectory of a chunk.

    Raises:
        TransportError: Shapes disagree.
    """
    shape = (len(chunk.time_from_start_ns), len(chunk.joint_names))
    if chunk.trajectory.q.shape != shape:
        raise TransportError(
            f"chunk of {shape[0]} times for {shape[1]} joints has samples of shape "
            f"{chunk.trajectory.q.shape}; they must be {shape}"
        )
    return chunk_codec.encode(chunk)


def decode_chunk(payload: bytes) -> TrajectoryChunk:
    """Inverse of `encode_chunk`; the values may still be NaN, which `deploy.safety` refuses.

    Raises:
        TransportError: Not a JointTrajectory, one whose points have not all positions,
            velocities and accelerations for every joint, or one that would take long to read.
    """
    decoded = chunk_codec.decode(payload)
    if decoded is not None:
        return decoded
    return _guarded(
        payload,
        JOINT_TRAJECTORY,
        lambda: chunk_codec.decode_pointwise(payload, MAX_IRREGULAR_POINTS),
    )


def peek_stamp_ns(payload: bytes) -> int | None:
    """The stamp of a message that begins with a header, without decoding the rest, ns.

    None if there is none; for messages that are not looked at any further.
    """
    if payload[:4] != _CDR_HEADER or len(payload) < 12:
        return None
    sec, nanosec = struct.unpack_from("<iI", payload, 4)
    return int(sec) * _NS_PER_S + int(nanosec)


def encode_joint_states(states: JointStates) -> bytes:
    """sensor_msgs/JointState of joint values.

    Raises:
        TransportError: Lengths disagree.
    """
    count = len(states.names)
    for name in ("position", "velocity", "effort"):
        length = len(getattr(states, name))
        if length not in (count, 0) or (name == "position" and length != count):
            raise TransportError(f"joint states of {count} joints have {length} in {name}")
    make = ros2_types.message_class
    message = make(JOINT_STATE)(
        header=_header(states.stamp_ns),
        name=list(states.names),
        position=np.ascontiguousarray(states.position, dtype=np.float64),
        velocity=np.ascontiguousarray(states.velocity, dtype=np.float64),
        effort=np.ascontiguousarray(states.effort, dtype=np.float64),
    )
    return ros2_types.encode(message, JOINT_STATE)


def decode_joint_states(payload: bytes) -> JointStates:
    """Inverse of `encode_joint_states`.

    Raises:
        TransportError: Not a JointState, or one whose lengths disagree.
    """
    message = _guarded(payload, JOINT_STATE, lambda: ros2_types.decode(payload, JOINT_STATE))
    count = len(message.name)
    lengths = (len(message.position), len(message.velocity), len(message.effort))
    if lengths[0] != count or any(length not in (count, 0) for length in lengths[1:]):
        raise TransportError(
            f"JointState names {count} joints but has {lengths} positions, velocities, efforts"
        )
    return JointStates(
        stamp_ns=_stamp_ns(message.header.stamp),
        names=tuple(message.name),
        position=np.array(message.position, dtype=np.float64),
        velocity=np.array(message.velocity, dtype=np.float64),
        effort=np.array(message.effort, dtype=np.float64),
    )


def encode_status(status: Status) -> bytes:
    """diagnostic_msgs/DiagnosticArray with one entry."""
    make = ros2_types.message_class
    pair = make("diagnostic_msgs/msg/KeyValue")
    entry = make("diagnostic_msgs/msg/DiagnosticStatus")(
        level=status.level,
        name=status.name,
        message=status.message,
        hardware_id=HARDWARE_ID,
        values=[pair(key=key, value=value) for key, value in status.values.items()],
    )
    message = make(DIAGNOSTIC_ARRAY)(header=_header(status.stamp_ns), status=[entry])
    return ros2_types.encode(message, DIAGNOSTIC_ARRAY)


def decode_status(payload: bytes) -> Status:
    """Inverse of `encode_status`; of several entries the first.

    Raises:
        TransportError: Not a DiagnosticArray, or an empty one.
    """
    message = _guarded(
        payload, DIAGNOSTIC_ARRAY, lambda: ros2_types.decode(payload, DIAGNOSTIC_ARRAY)
    )
    if not message.status:
        raise TransportError("DiagnosticArray without an entry")
    entry = message.status[0]
    return Status(
        stamp_ns=_stamp_ns(message.header.stamp),
        name=entry.name,
        level=int(entry.level),
        message=entry.message,
        values={pair.key: pair.value for pair in entry.values},
    )


def encode_trigger_request(extra: bytes = b"") -> bytes:
    """std_srvs/Trigger request: CDR of an empty structure is one zero byte.

    `extra` follows it: our own addition, which ROS 2 services do not look at.
    """
    return _CDR_HEADER + b"\x00" + extra


def decode_trigger_request(payload: bytes) -> bytes:
    """The `extra` of a request; empty for one that a ROS 2 node sent.

    Raises:
        TransportError: Not a request.
    """
    if payload[:4] != _CDR_HEADER:
        raise TransportError(f"malformed Trigger request of {len(payload)} bytes")
    return payload[5:]


def encode_trigger_reply(reply: TriggerReply) -> bytes:
    """std_srvs/Trigger response: a boolean, padding and a string."""
    text = reply.message.encode() + b"\x00"
    return _CDR_HEADER + struct.pack("<?xxxI", reply.success, len(text)) + text


def decode_trigger_reply(payload: bytes) -> TriggerReply:
    """Inverse of `encode_trigger_reply`.

    Raises:
        TransportError: Not a response.
    """

    def decode() -> TriggerReply:
        if payload[:4] != _CDR_HEADER:
            raise ValueError("not little-endian CDR")
        success, length = struct.unpack_from("<BxxxI", payload, 4)
        text = payload[12 : 12 + length]
        if success > 1 or length < 1 or len(text) != length or text[-1] != 0:
            raise ValueError("lengths disagree")
        return TriggerReply(bool(success), text[:-1].decode())

    return _guarded(payload, "std_srvs/srv/Trigger response", decode)


def _guarded(payload: bytes, type_name: str, decode: Callable[[], _Message]) -> _Message:
    try:
        return decode()
    except MALFORMED as error:
        raise TransportError(
            f"malformed {type_name} of {len(payload)} bytes: {str(error) or type(error).__name__}"
        ) from error


def _stamp_ns(stamp: Any) -> int:
    return int(stamp.sec) * _NS_PER_S + int(stamp.nanosec)


def _header(stamp_ns: int) -> Any:
    sec, nanosec = divmod(int(stamp_ns), _NS_PER_S)
    make = ros2_types.message_class
    stamp = make("builtin_interfaces/msg/Time")(sec=sec, nanosec=nanosec)
    return make("std_msgs/msg/Header")(stamp=stamp, frame_id="")
