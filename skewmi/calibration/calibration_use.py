"""What users of a calibration make of its file."""

from __future__ import annotations

import hashlib
import json
import math

import numpy as np

from skewmi.calibration.calibration_file import Calibration
from skewmi.errors import ConfigurationError
from skewmi.robot_models.feed_forward import ServoConstants

EGM = "egm"
"""The robot whose controller is guided by EGM, as robot servers call it."""


def require_robot(calibration: Calibration, robot: str, speed_share: float | None = None) -> None:
    """See that a calibration is of the kind of robot that it is used on.

    Args:
        calibration: That shall be used.
        robot: What its robot server calls it, such as "sim" or "egm".
        speed_share: Part of the plan's speed that a bridge sends as speed reference; None if that
            is not known.

    Raises:
        ConfigurationError: It is of another kind, or was made with another share.
    """
    egm = calibration.egm
    if robot == EGM and calibration.servo is not None:
        raise ConfigurationError(
            "the calibration is of servos that follow commands themselves (section servo), and the "
            "robot is one behind EGM, whose controller has a law of its own: run skewmi calibrate "
            "excite and servo on it, and give the calibration that comes of it (section egm)"
        )
    if robot != EGM and egm is not None:
        raise ConfigurationError(
            f"the calibration is of a controller guided by EGM (section egm), and the robot is "
            f"{robot!r}, whose servos follow commands themselves: give one that was made on it "
            "(section servo), or none"
        )
    if egm is not None and speed_share is not None and egm.speed_share != speed_share:
        raise ConfigurationError(
            f"the calibration was made with {egm.speed_share:g} of the plan's speed sent as speed "
            f"reference, the bridge sends {speed_share:g}: give it --egm-feed-forward "
            f"{egm.speed_share:g}, or calibrate again"
        )


def servo_constants(calibration: Calibration | None) -> ServoConstants | None:
    """What feed-forward takes of it; None if neither servos nor a controller were calibrated."""
    if calibration is None:
        return None
    servo, egm = calibration.servo, calibration.egm
    if egm is not None:
        # What is not sent of the speed, the law's gain makes of an error that it needs for it.
        behind = (1.0 - egm.speed_share) / egm.gain.value[0]
        late = np.maximum(np.array(egm.lag_ms.value) / 1e3, 0.0) + behind
        return ServoConstants(late, np.array(egm.servo.frictionloss_over_kp.value))
    if servo is None:
        return None
    lead = np.array(servo.kd_over_kp.value) + servo.delay_ms.value[0] / 1e3
    return ServoConstants(lead, np.array(servo.frictionloss_over_kp.value))


def low_pass_s(calibration: Calibration) -> float:
    """Time constant of the low-pass of a controller's law, s; 0 if there is none."""
    egm = calibration.egm
    return 0.0 if egm is None else 1.0 / (2.0 * math.pi * egm.low_pass_hz.value[0])


def known_delay_s(calibration: Calibration) -> float:
    """By how much an arm is behind its commands that gets no feed-forward, s; 0 if unknown."""
    servo, egm = calibration.servo, calibration.egm
    if egm is not None:
        return max(0.0, float(np.mean(egm.lag_ms.value))) / 1e3
    return 0.0 if servo is None else servo.delay_ms.value[0] / 1e3


def fingerprint(calibration: Calibration) -> str:
    """Sixteen hexadecimal digits by which two parties see whether they mean the same one."""
    text = json.dumps(calibration.as_mapping(), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def lid_bias(calibration: Calibration) -> float | None:
    """What a shut lid's sensor reads, rad; None if that was not measured.

    Then it is told by the first reading of each episode: the lid is shut there.
    """
    scene = calibration.scene
    if scene is None or scene.lid_bias_deg.assumed[0]:
        return None
    return math.radians(scene.lid_bias_deg.value[0])


LARGEST_LID_BIAS = math.radians(20.0)
"""A first reading that is farther from shut is no bias, rad: the lid is open."""
