"""The last look at a reference before it leaves: a controller may not survive what is wrong in it.

A value that is not a number brings the controller of an IRB 14000 down ("10014 System failure
state"), in RobotStudio so that it no longer starts by a warm restart. One outside of an axis'
range ends the session and, with some clients, every session after it. So whatever went wrong
before, such a packet does not get past this check; it does not depend on any other.
"""

from __future__ import annotations

import math
from math import degrees

from skewmi.deploy.robot.backends.egm.packets import ReferencePacket
from skewmi.errors import LimitViolationError
from skewmi.robot_models.yumi import ABB_AXES, JOINT_RANGES
from skewmi.trajectory import Array

_ROUNDING = 1e-9
"""rad: a joint at the very end of its range passes."""


def check_reference(packet: ReferencePacket) -> None:
    """Whether a reference may be sent.

    Raises:
        LimitViolationError: A value is not finite, or outside of what the axis can do.
    """
    _check_length(packet.q)
    for axis, value, bounds in zip(ABB_AXES, packet.q.tolist(), JOINT_RANGES, strict=True):
        if not math.isfinite(value):
            raise LimitViolationError(f"reference of axis {axis}", value, bounds.upper, "finite")
        if not bounds.lower - _ROUNDING <= value <= bounds.upper + _ROUNDING:
            bound = bounds.lower if value < bounds.lower else bounds.upper
            raise LimitViolationError(
                f"reference of axis {axis}", value, bound, f"{degrees(value):.2f} deg"
            )
    if packet.v is None:
        return
    _check_length(packet.v)
    for axis, value, bounds in zip(ABB_AXES, packet.v.tolist(), JOINT_RANGES, strict=True):
        if not math.isfinite(value) or abs(value) > bounds.velocity + _ROUNDING:
            raise LimitViolationError(
                f"speed of axis {axis}", value, bounds.velocity, f"{degrees(value):.2f} deg/s"
            )


def _check_length(values: Array) -> None:
    count = len(values)
    if count != len(ABB_AXES):
        raise LimitViolationError("joints in a reference", count, len(ABB_AXES))
