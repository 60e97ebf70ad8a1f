"""What the identification of a law refuses; `benchmarks/egm_law.py` shows what it finds."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from egm_arms import PERIOD_S

from skewmi.calibration.egm_identification import EgmIdentifier
from skewmi.calibration.egm_law import EgmLaw
from skewmi.calibration.egm_model import EgmRecording
from skewmi.calibration.excitation import Excitation
from skewmi.calibration.excitation_choice import excitation_centre
from skewmi.calibration.servo_model import ServoModel
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.errors import ConfigurationError
from skewmi.robot_models import limits
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.trajectory import GRID_S, JointTrajectory

ANNOUNCED = EgmLaw(20.0, 20.0)


@functools.cache
def motion() -> JointTrajectory:
    asked = Excitation(5.0, 1, tcp_speed=0.18)
    return asked.motion(excitation_centre(), limits.profile("lab"))


@functools.cache
def model() -> ServoModel:
    return ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp)


def test_recordings_that_do_not_belong_together_are_refused() -> None:
    resting = JointTrajectory.resting(excitation_centre(), 1000)
    still = ServoRecording(resting, GRID_S * np.arange(1000), resting.q)
    one = EgmRecording(still, PERIOD_S, 1.0)
    with pytest.raises(ConfigurationError, match="one recording at least"):
        EgmIdentifier(model(), [], CONTACT_SERVO, ANNOUNCED)
    with pytest.raises(ConfigurationError, match="do not move"):
        EgmIdentifier(model(), [one], CONTACT_SERVO, ANNOUNCED)
    moving = ServoRecording(motion(), GRID_S * np.arange(1000), motion().q[:1000])
    for other in (EgmRecording(moving, 1.01 * PERIOD_S, 1.0), EgmRecording(moving, PERIOD_S, 0.5)):
        with pytest.raises(ConfigurationError, match="set-ups"):
            EgmIdentifier(
                model(), [EgmRecording(moving, PERIOD_S, 1.0), other], CONTACT_SERVO, ANNOUNCED
            )
