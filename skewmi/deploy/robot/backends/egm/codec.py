"""EGM packets as bytes: the only place that knows degrees, millimetres and ABB's order of axes.

On the wire `joints` are the axes 1 to 6 and the first of `externalJoints` is axis 7, in degrees.
The chain of a YuMi's arm is 1, 2, 7, 3, 4, 5, 6.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from google.protobuf.message import DecodeError

from skewmi.deploy.robot.backends.egm.messages import EgmRobot, EgmSensor
from skewmi.deploy.robot.backends.egm.packets import (
    FeedbackPacket,
    Mci,
    Motors,
    Pose,
    Rapid,
    ReferencePacket,
)
from skewmi.errors import SkewmiError
from skewmi.robot_models.yumi import ABB_AXES
from skewmi.trajectory import Array

MAX_DATAGRAM = 1472
"""Bytes: what fits into one Ethernet frame. Controllers send some 400, RobotWare 7 up to 900."""

_DATA, _CORRECTION = 2, 3
_MM = 1e3
_US_PER_S = 1_000_000
_ROBOT_AXES = 6
_NO_MORE_AXES = (0.0,) * 5
"""A controller tells six external values, an arm of a YuMi has one (manual, p. 38)."""
_CHAIN_FROM_WIRE = np.array([axis - 1 for axis in ABB_AXES])
"""Chain joint i is wire value `_CHAIN_FROM_WIRE[i]` of (1, 2, 3, 4, 5, 6, 7)."""
_WIRE_FROM_CHAIN = np.argsort(_CHAIN_FROM_WIRE)


class MalformedPacketError(SkewmiError):
    """Bytes that are no EGM packet of the kind expected; the message says why."""


def decode_feedback(datagram: bytes) -> FeedbackPacket:
    """Read what a controller sent.

    Raises:
        MalformedPacketError: It is not a packet of a seven-axis controller.
    """
    message = _parse(EgmRobot, datagram)
    if message.header.mtype != _DATA:
        raise MalformedPacketError(
            f"message type {message.header.mtype}; a controller sends {_DATA} (data)"
        )
    _require(message, ("header", "feedBack", "motorState", "mciState"))
    feedback, planned = message.feedBack, message.planned
    return FeedbackPacket(
        sequence=message.header.seqno,
        q=_joints(feedback, "feedBack"),
        motors=Motors(message.motorState.state),
        mci=Mci(message.mciState.state),
        rapid=Rapid(message.rapidExecState.state),
        clock_us=_clock_us(feedback),
        time_ms=message.header.tm,
        planned_q=_joints(planned, "planned") if planned.HasField("joints") else None,
        converged=message.mciConvergenceMet,
        utilization=_utilization(message),
        flange=_pose(feedback),
        planned_flange=_pose(planned),
        robotware=7 if _has_new_fields(message) else 6,
        move_index=message.moveIndex if message.HasField("moveIndex") else None,
    )


def encode_feedback(packet: FeedbackPacket) -> bytes:
    """What a controller sends. RobotWare 7 adds its own fields."""
    message = EgmRobot()
    message.header.seqno = packet.sequence
    message.header.tm = packet.time_ms
    message.header.mtype = _DATA
    planned_q = packet.q if packet.planned_q is None else packet.planned_q
    for part, q, pose in (
        (message.feedBack, packet.q, packet.flange),
        (message.planned, planned_q, packet.planned_flange),
    ):
        _set_joints(part, q)
        part.externalJoints.joints.extend(_NO_MORE_AXES)
        if pose is not None:
            _set_pose(part.cartesian, pose)
        if packet.clock_us is not None:
            part.time.sec, part.time.usec = divmod(packet.clock_us, _US_PER_S)
            if packet.robotware >= 7:
                part.timeStamp.sec = part.time.sec
                part.timeStamp.nsec = part.time.usec * 1000
    message.motorState.state = packet.motors.value
    message.mciState.state = packet.mci.value
    message.mciConvergenceMet = packet.converged
    message.rapidExecState.state = packet.rapid.value
    if packet.utilization is not None:
        message.utilizationRate = packet.utilization
    if packet.robotware >= 7:
        message.moveIndex = packet.move_index or 0
        message.measuredForce.fcActive = False
        message.CollisionInfo.collsionTriggered = False
        message.RAPIDfromRobot.digVal = False
    return bytes(message.SerializeToString())


def decode_reference(datagram: bytes) -> ReferencePacket:
    """Read what a controller is answered with.

    Values are taken as they are: what a controller does with one that is not a number is the
    controller's business.

    Raises:
        MalformedPacketError: It is not a joint correction for a seven-axis controller.
    """
    message = _parse(EgmSensor, datagram)
    if message.header.mtype != _CORRECTION:
        raise MalformedPacketError(
            f"message type {message.header.mtype}; a sensor sends {_CORRECTION} (correction)"
        )
    if not message.planned.HasField("joints"):
        raise MalformedPacketError("it has no joint positions; pose guidance has six axes only")
    speed = message.speedRef
    has_speed = speed.HasField("joints") or speed.HasField("externalJoints")
    return ReferencePacket(
        sequence=message.header.seqno,
        time_ms=message.header.tm,
        q=_joints(message.planned, "planned", finite=False),
        v=_joints(speed, "speedRef", finite=False) if has_speed else None,
    )


def encode_reference(packet: ReferencePacket) -> bytes:
    """What a controller is answered with."""
    message = EgmSensor()
    message.header.seqno = packet.sequence
    message.header.tm = packet.time_ms
    message.header.mtype = _CORRECTION
    _set_joints(message.planned, packet.q)
    if packet.v is not None:
        _set_joints(message.speedRef, packet.v)
    return bytes(message.SerializeToString())


def _parse(kind: Any, datagram: bytes) -> Any:
    """Size first, then the bytes, then what ABB's format requires."""
    if not 0 < len(datagram) <= MAX_DATAGRAM:
        raise MalformedPacketError(f"{len(datagram)} bytes; 1 to {MAX_DATAGRAM} are expected")
    message = kind()
    try:
        message.ParseFromString(datagram)
    except DecodeError:
        raise MalformedPacketError(
            f"{len(datagram)} bytes that are no {kind.DESCRIPTOR.name}"
        ) from None
    if not message.IsInitialized():
        missing = ", ".join(message.FindInitializationErrors()[:3])
        raise MalformedPacketError(f"{kind.DESCRIPTOR.name} lacks {missing}")
    return message


def _require(message: Any, fields: tuple[str, ...]) -> None:
    missing = [field for field in fields if not message.HasField(field)]
    if missing:
        raise MalformedPacketError(f"{message.DESCRIPTOR.name} lacks {', '.join(missing)}")


def _joints(part: Any, name: str, *, finite: bool = True) -> Array:
    """Joints of a part of a message in chain order, rad. Shape (7,)."""
    robot, external = part.joints.joints, part.externalJoints.joints
    if len(robot) != _ROBOT_AXES or not external:
        raise MalformedPacketError(
            f"{name} has {len(robot)} joints and {len(external)} external ones; an arm of a YuMi "
            f"has {_ROBOT_AXES} and 1 (its axis 7)"
        )
    q: Array = np.radians(np.array([*robot, external[0]])[_CHAIN_FROM_WIRE])
    if finite and not np.isfinite(q).all():
        raise MalformedPacketError(f"{name} has a joint that is not a finite number")
    return q


def _set_joints(part: Any, q: Array) -> None:
    degrees = np.degrees(q)[_WIRE_FROM_CHAIN].tolist()
    part.joints.joints.extend(degrees[:_ROBOT_AXES])
    part.externalJoints.joints.append(degrees[_ROBOT_AXES])


def _pose(part: Any) -> Pose | None:
    pose = part.cartesian
    if not (pose.HasField("pos") and pose.HasField("orient")):
        return None
    position, turn = pose.pos, pose.orient
    return Pose(
        np.array([position.x, position.y, position.z]) / _MM,
        np.array([turn.u0, turn.u1, turn.u2, turn.u3]),
    )


def _set_pose(part: Any, pose: Pose) -> None:
    part.pos.x, part.pos.y, part.pos.z = (pose.position * _MM).tolist()
    turn = part.orient
    turn.u0, turn.u1, turn.u2, turn.u3 = pose.quaternion_wxyz.tolist()


def _clock_us(part: Any) -> int | None:
    if not part.HasField("time"):
        return None
    return int(part.time.sec) * _US_PER_S + int(part.time.usec)


def _utilization(message: Any) -> float | None:
    if not message.HasField("utilizationRate"):
        return None
    rate = float(message.utilizationRate)
    if not np.isfinite(rate):
        raise MalformedPacketError("the utilisation rate is not a finite number")
    return rate


def _has_new_fields(message: Any) -> bool:
    return bool(
        message.HasField("moveIndex")
        or message.HasField("CollisionInfo")
        or message.HasField("RAPIDfromRobot")
        or message.HasField("torqueRef")
        or message.feedBack.HasField("timeStamp")
    )
