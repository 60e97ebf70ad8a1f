"""Calibrations of robots whose constants are given."""

from __future__ import annotations

import numpy as np

from skewmi.calibration.calibration_file import (
    Calibration,
    Constant,
    EgmCalibration,
    ServoCalibration,
)
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.trajectory import Array


def exact_calibration(
    kp_scale: float = 1.0,
    kd_scale: float = 1.0,
    frictionloss: float | list[float] | None = None,
    delay_ms: float = 0.0,
) -> Calibration:
    """That of a robot with these factors on the nominal servos and this friction, N m."""
    kp, kd = kp_scale * CONTACT_SERVO.kp, kd_scale * CONTACT_SERVO.kd
    friction = CONTACT_SERVO.frictionloss if frictionloss is None else np.zeros(7) + frictionloss

    servo = ServoCalibration(
        kp=exactly(kp),
        kd=exactly(kd),
        frictionloss=exactly(friction),
        armature=exactly(CONTACT_SERVO.armature),
        kd_over_kp=exactly(kd / kp),
        frictionloss_over_kp=exactly(friction / kp),
        delay_ms=exactly(delay_ms),
    )
    return Calibration("2026-01-02T03:04:05Z", "1.2.3", servo)


def exact_egm_calibration(
    gain: float = 20.0, low_pass_hz: float = 20.0, lag_ms: float = 20.0, speed_share: float = 1.0
) -> Calibration:
    """That of a robot behind EGM with this law, this lag of every joint, and nominal servos."""
    servo = exact_calibration(delay_ms=lag_ms + 4.032).servo
    assert servo is not None
    egm = EgmCalibration(
        period_ms=4.032,
        speed_share=speed_share,
        gain=exactly(gain),
        low_pass_hz=exactly(low_pass_hz),
        lag_ms=exactly(np.full(7, lag_ms)),
        servo=servo,
    )
    return Calibration("2026-01-02T03:04:05Z", "1.2.3", egm=egm)


def exactly(value: Array | float) -> Constant:
    """One number, or seven, without a doubt."""
    values = tuple(map(float, np.atleast_1d(value)))
    return Constant(values, values, values, (False,) * len(values))
