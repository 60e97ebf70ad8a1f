"""From a calibration's intervals to the ranges of a variation to train with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from skewmi.calibration.calibration_file import Calibration, Constant, ServoCalibration
from skewmi.calibration.servo_estimates import KNOWN_FRICTION, sticks
from skewmi.errors import ConfigurationError
from skewmi.robot_models import yumi
from skewmi.robot_models.servo import ServoParameters
from skewmi.robot_models.yumi import Array

STICTION_SCALE = "servo.stiction_scale"
STRIBECK_VELOCITY = "servo.stribeck_velocity"
FLOORS: Mapping[str, float] = {
    "servo.kp_scale": 0.05,
    "servo.kd_scale": 0.05,
    "servo.frictionloss": 0.05,
    "servo.delay_ms": 2.0,
    STICTION_SCALE: 0.1,
    STRIBECK_VELOCITY: 0.01,
    "box_pose.x": 0.001,
    "box_pose.y": 0.001,
    "box_pose.yaw_deg": 0.3,
    "sensors.lid_bias_deg": 0.5,
}
"""Least half-widths, in each key's unit: a warm gear box has other friction than a cold one, a
clamp gives a little, and no calibration tells tomorrow's values."""


@dataclass(frozen=True, eq=False)
class _Known:
    """What a calibration tells of one key, in the key's unit. Each shape (1,) or (7,).

    Attributes:
        value, low, high: With its interval.
        matters: Whether it does anything.
    """

    value: Array
    low: Array
    high: Array
    matters: tuple[bool, ...]


def variation_ranges(
    calibration: Calibration,
    nominal: ServoParameters,
    widen: float,
    allowed: Mapping[str, tuple[float, float]],
) -> dict[str, dict[str, object]]:
    """The content of a variation file. What it cannot hold, `range_warnings` tells.

    Args:
        calibration: Gives the intervals.
        nominal: Servos that the variation's factors are of.
        widen: Factor on the half-widths.
        allowed: Lowest and highest value of each key that the variation may have; others are left
            out.

    Raises:
        ConfigurationError: It knows nothing but a controller guided by EGM.
    """
    if calibration.egm is not None and calibration.scene is None:
        raise ConfigurationError(
            "the calibration is of a controller guided by EGM (section egm); the robots of a "
            "variation have servos that follow commands themselves: there is nothing to widen"
        )
    content: dict[str, dict[str, object]] = {}
    for key, known in _known(calibration, nominal).items():
        if key not in allowed:
            continue
        half = widen * np.maximum(known.high - known.value, known.value - known.low)
        half = np.maximum(half, FLOORS[key])
        ends = np.clip([known.value - half, known.value + half], *allowed[key])
        rows = ends.T.round(6).tolist()
        section, _, short = key.partition(".")
        content.setdefault(section, {})[short] = rows[0] if len(rows) == 1 else rows
    return content


def range_warnings(
    calibration: Calibration,
    nominal: ServoParameters,
    allowed: Mapping[str, tuple[float, float]],
) -> tuple[str, ...]:
    """What is calibrated and beyond what a variation may have, a sentence each.

    Args:
        calibration, nominal, allowed: As for `variation_ranges`.
    """
    warnings = []
    for key, known in _known(calibration, nominal).items():
        if key not in allowed:
            continue
        least, most = allowed[key]
        joints = yumi.joint_names("right") if len(known.value) > 1 else ("",)
        for joint, value, low, high, matters in zip(
            joints, known.value, known.low, known.high, known.matters, strict=True
        ):
            if not matters or (least <= low and high <= most):
                continue
            of_joint = f" of {joint}" if joint else ""
            missed = "" if least <= value <= most else ", and no robot of it is like the calibrated"
            warnings.append(
                f"{key}{of_joint} is {value:.4g} ({low:.4g} to {high:.4g}) by the calibration; a "
                f"variation allows {least:g} to {most:g}: the range ends there{missed}"
            )
    return tuple(warnings)


def _known(calibration: Calibration, nominal: ServoParameters) -> dict[str, _Known]:
    """By key, in the order of a variation file."""
    servo, scene = calibration.servo, calibration.scene
    found = {}
    if servo is not None:
        found = {
            "servo.kp_scale": _in_units(servo.kp, nominal.kp),
            "servo.kd_scale": _in_units(servo.kd, nominal.kd),
            "servo.frictionloss": _in_units(servo.frictionloss),
            "servo.delay_ms": _in_units(servo.delay_ms),
            **_known_stiction(servo),
        }
    if scene is not None:
        for name in ("x", "y", "yaw_deg"):
            found[f"box_pose.{name}"] = _in_units(getattr(scene, name))
        found["sensors.lid_bias_deg"] = _in_units(scene.lid_bias_deg)
    return found


def _in_units(constant: Constant, unit: Array | float = 1.0) -> _Known:
    value, low, high = (
        np.array(part) / unit for part in (constant.value, constant.low, constant.high)
    )
    return _Known(value, low, high, (True,) * len(value))


def _known_stiction(servo: ServoCalibration) -> dict[str, _Known]:
    """Friction at rest by that in motion, s = (F_c + F_m) / F_c, and where it has gone.

    Both are uncertain, but hardly their sum: the less there is in motion, the more is left for
    rest. So an end of the interval is made of opposite ends of the two.
    """
    if servo.stiction is None or servo.stribeck_velocity is None:
        return {}
    more, moving = _in_units(servo.stiction), _in_units(servo.frictionloss)
    # Less than that is not told from none, and dividing by it would make much of nothing.
    value, low, high = (
        1.0 + part / np.maximum(by, KNOWN_FRICTION)
        for part, by in (
            (more.value, moving.value),
            (more.low, moving.high),
            (more.high, moving.low),
        )
    )
    speed = _in_units(servo.stribeck_velocity)
    matters = tuple(sticks(more.value).tolist())
    return {
        STICTION_SCALE: _Known(value, low, high, (True,) * len(value)),
        STRIBECK_VELOCITY: _Known(speed.value, speed.low, speed.high, matters),
    }
