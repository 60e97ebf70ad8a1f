"""CDR of control_msgs/JointTrajectoryControllerState: what an arm was told in one cycle.

Told 250 times a second by a loop that has little time. All messages of one arm have the same bytes
but for stamp and numbers, so the bytes are laid out once (by rosbags, the reference) and patched in
place after that, as `chunk_codec` does. Where the numbers lie is found by looking: each is laid out
with a value of its own.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skewmi.deploy.wire import ros2_types
from skewmi.deploy.wire.chunk_codec import MAX_JOINTS, parse_names
from skewmi.deploy.wire.topics import CONTROLLER_STATE
from skewmi.errors import TransportError
from skewmi.trajectory import Array, JointPoint

_NS_PER_S = 1_000_000_000
_STAMP = struct.Struct("<iI")
_STAMP_AT = 4
_ARRAYS = (
    *(("reference", "positions"), ("reference", "velocities"), ("reference", "accelerations")),
    *(("feedback", "positions"), ("feedback", "velocities"), ("feedback", "effort")),
    *(("error", "positions"), ("error", "velocities")),
)
"""The arrays that are filled, in their order in the message; all others are empty."""


@dataclass(frozen=True)
class ControllerState:
    """One cycle of an arm.

    Attributes:
        stamp_ns: Of the cycle, in the robot server's clock.
        names: Of the joints.
        reference: What was written: to hold from this cycle on. rad, rad/s, rad/s^2; shape (n,).
        position: What was measured in this cycle, rad. Shape (n,).
        velocity: rad/s. Shape (n,).
        effort: N m. Shape (n,).
    """

    stamp_ns: int
    names: tuple[str, ...]
    reference: JointPoint
    position: Array
    velocity: Array
    effort: Array


class _Layout:
    """The bytes of every message for some joints, and the arrays inside them.

    Args:
        names: Of the joints.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        joints = len(names)
        marks = np.arange(1.0, 1.0 + joints * len(_ARRAYS)).reshape(len(_ARRAYS), joints)
        data = ros2_types.encode(_message(names, marks), CONTROLLER_STATE)
        self.buffer = bytearray(data)
        self.places = [data.index(row.astype("<f8").tobytes()) for row in marks]
        self.arrays = [
            np.frombuffer(self.buffer, dtype="<f8", count=joints, offset=place)
            for place in self.places
        ]
        for array in self.arrays:
            array[:] = 0.0
        fixed = np.ones(len(data), dtype=bool)
        fixed[_STAMP_AT : _STAMP_AT + _STAMP.size] = False
        for place in self.places:
            fixed[place : place + 8 * joints] = False
        self.fixed: NDArray[np.bool_] = fixed
        self.constant = np.frombuffer(bytes(self.buffer), dtype=np.uint8)[fixed]


_layout = lru_cache(maxsize=16)(_Layout)


def encode_controller_state(state: ControllerState) -> bytes:
    """Bytes of a message. Not thread-safe: the layout is shared.

    Raises:
        TransportError: An array has not one number for each joint.
    """
    layout = _layout(state.names)
    position, velocity, acceleration = state.reference
    measured, speed = state.position, state.velocity
    values = (position, velocity, acceleration, measured, speed, state.effort)
    try:
        for array, value in zip(layout.arrays, values, strict=False):
            array[:] = value
        np.subtract(position, measured, out=layout.arrays[6])
        np.subtract(velocity, speed, out=layout.arrays[7])
    except ValueError as error:
        shapes = ", ".join(str(np.shape(value)) for value in values)
        raise TransportError(
            f"the controller state of {len(state.names)} joints has arrays of shapes {shapes}"
        ) from error
    _STAMP.pack_into(layout.buffer, _STAMP_AT, *divmod(int(state.stamp_ns), _NS_PER_S))
    return bytes(layout.buffer)


def decode_controller_state(payload: bytes) -> ControllerState:
    """Inverse of `encode_controller_state`; the numbers may be NaN.

    Raises:
        TransportError: Not a message of this type and form.
    """
    parsed = parse_names(payload)
    if parsed is None or not 0 < len(parsed[1]) <= MAX_JOINTS:
        raise TransportError(f"malformed {CONTROLLER_STATE} of {len(payload)} bytes")
    stamp_ns, names, _, _ = parsed
    layout = _layout(names)
    data = np.frombuffer(payload, dtype=np.uint8)
    if len(data) != len(layout.fixed) or (data[layout.fixed] != layout.constant).any():
        raise TransportError(
            f"a {CONTROLLER_STATE} of {len(payload)} bytes for {len(names)} joints is not of the "
            "form that robot servers send: reference with accelerations, feedback with effort, "
            "error, nothing else"
        )
    q, v, a, position, velocity, effort = (
        np.frombuffer(payload, dtype="<f8", count=len(names), offset=place).astype(np.float64)
        for place in layout.places[:6]
    )
    return ControllerState(stamp_ns, names, JointPoint(q, v, a), position, velocity, effort)


def _message(names: tuple[str, ...], values: Array) -> Any:
    """A message of rosbags'; shape of the values (len(_ARRAYS), len(names))."""
    make = ros2_types.message_class
    filled = dict(zip(_ARRAYS, values, strict=True))
    nothing, no_time = np.zeros(0), make("builtin_interfaces/msg/Duration")(sec=0, nanosec=0)
    parts = ("positions", "velocities", "accelerations", "effort")

    def point(name: str) -> Any:
        arrays = {part: filled.get((name, part), nothing) for part in parts}
        kind = make("trajectory_msgs/msg/JointTrajectoryPoint")
        return kind(**arrays, time_from_start=no_time)

    several = make("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint")(
        transforms=[], velocities=[], accelerations=[], time_from_start=no_time
    )
    stamp = make("builtin_interfaces/msg/Time")(sec=0, nanosec=0)
    points = {name: point(name) for name in ("reference", "feedback", "error", "output")}
    return make(CONTROLLER_STATE)(
        header=make("std_msgs/msg/Header")(stamp=stamp, frame_id=""),
        joint_names=list(names),
        **points,
        multi_dof_joint_names=[],
        **{f"multi_dof_{name}": several for name in points},
        speed_scaling_factor=1.0,
    )
