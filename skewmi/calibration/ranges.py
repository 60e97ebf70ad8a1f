"""From a calibration's intervals to the ranges of a variation to train with."""

from __future__ import annotations

from collections.abc import Mapping

from skewmi.calibration.calibration_file import Calibration, Constant
from skewmi.errors import ConfigurationError
from skewmi.robot_models.servo import ServoParameters

FLOORS: Mapping[str, float] = {
    "servo.kp_scale": 0.05,
    "servo.kd_scale": 0.05,
    "servo.frictionloss": 0.05,
    "servo.delay_ms": 2.0,
    "box_pose.x": 0.001,
    "box_pose.y": 0.001,
    "box_pose.yaw_deg": 0.3,
    "sensors.lid_bias_deg": 0.5,
}
"""Least half-widths, in each key's unit: a warm gear box has other friction than a cold one, a
clamp gives a little, and no calibration tells tomorrow's values."""


def variation_ranges(
    calibration: Calibration,
    nominal: ServoParameters,
    widen: float,
    allowed: Mapping[str, tuple[float, float]],
) -> dict[str, dict[str, object]]:
    """The content of a variation file.

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
    ranges: dict[str, list[list[float]]] = {}

    def add(key: str, constant: Constant, units: tuple[float, ...]) -> None:
        if key not in allowed:
            return
        low_allowed, high_allowed = allowed[key]
        rows = []
        for low, value, high, unit in zip(
            constant.low, constant.value, constant.high, units, strict=True
        ):
            half = max(widen * (high - value), widen * (value - low)) / unit
            half = max(half, FLOORS[key])
            middle = value / unit
            rows.append(
                [
                    round(min(max(middle + side * half, low_allowed), high_allowed), 6)
                    for side in (-1.0, 1.0)
                ]
            )
        ranges[key] = rows

    servo, scene = calibration.servo, calibration.scene
    if servo is not None:
        ones = (1.0,) * 7
        add("servo.kp_scale", servo.kp, tuple(nominal.kp.tolist()))
        add("servo.kd_scale", servo.kd, tuple(nominal.kd.tolist()))
        add("servo.frictionloss", servo.frictionloss, ones)
        add("servo.delay_ms", servo.delay_ms, (1.0,))
    if scene is not None:
        for name in ("x", "y", "yaw_deg"):
            add(f"box_pose.{name}", getattr(scene, name), (1.0,))
        add("sensors.lid_bias_deg", scene.lid_bias_deg, (1.0,))
    content: dict[str, dict[str, object]] = {}
    for key, rows in ranges.items():
        section, _, short = key.partition(".")
        content.setdefault(section, {})[short] = rows[0] if len(rows) == 1 else rows
    return content
