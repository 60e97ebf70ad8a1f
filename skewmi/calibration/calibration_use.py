"""What users of a calibration make of its file."""

from __future__ import annotations

import hashlib
import json
import math

import numpy as np

from skewmi.calibration.calibration_file import Calibration
from skewmi.robot_models.feed_forward import ServoConstants
from skewmi.robot_models.hand_stiffness import hand_stiffness
from skewmi.robot_models.yumi import Array


def servo_constants(calibration: Calibration) -> ServoConstants | None:
    """What feed-forward takes of it; None if the servos were not calibrated."""
    servo = calibration.servo
    if servo is None:
        return None
    lead = np.array(servo.kd_over_kp.value) + servo.delay_ms.value[0] / 1e3
    return ServoConstants(lead, np.array(servo.frictionloss_over_kp.value))


def known_stiffness(calibration: Calibration, configuration: Array) -> Array | None:
    """What a command integrator takes of it; None if the servos were not calibrated.

    Args:
        calibration: Of the robot.
        configuration: At which the hand's stiffness is taken, rad. Shape (7,).
    """
    servo = calibration.servo
    return None if servo is None else hand_stiffness(np.array(servo.kp.value), configuration)


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
