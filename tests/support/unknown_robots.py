"""Calibrations of robots whose constants are given."""

from __future__ import annotations

import numpy as np

from skewmi.calibration.calibration_file import Calibration, Constant, ServoCalibration
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

    def known(value: Array | float) -> Constant:
        values = tuple(map(float, np.atleast_1d(value)))
        return Constant(values, values, values, (False,) * len(values))

    servo = ServoCalibration(
        kp=known(kp),
        kd=known(kd),
        frictionloss=known(friction),
        armature=known(CONTACT_SERVO.armature),
        kd_over_kp=known(kd / kp),
        frictionloss_over_kp=known(friction / kp),
        delay_ms=known(delay_ms),
    )
    return Calibration("2026-01-02T03:04:05Z", "1.2.3", servo)
