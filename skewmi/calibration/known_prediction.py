"""What a moving arm is compared with: the prediction that suits what is known of it."""

from __future__ import annotations

from skewmi.calibration.calibration_file import Calibration
from skewmi.calibration.egm_prediction import EgmPrediction
from skewmi.calibration.egm_section import egm_arm
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_prediction import ServoPrediction
from skewmi.calibration.servo_section import servo_start
from skewmi.robot_models.servo import ServoParameters


def prediction_of(
    known: Calibration | None, model: ServoModel, nominal: ServoParameters
) -> ServoPrediction | EgmPrediction:
    """Of a known arm, or of one with nominal servos if nothing is known.

    Args:
        known: Of the robot.
        model: Of the servos.
        nominal: What no calibration tells.
    """
    if known is not None and known.egm is not None:
        return EgmPrediction(egm_arm(known.egm, nominal), known.egm.speed_share, model)
    if known is not None and known.servo is not None:
        return ServoPrediction(servo_start(known.servo, nominal), model)
    return ServoPrediction(DelayedServo(nominal, 0.0), model)
