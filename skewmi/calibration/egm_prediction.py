"""Where an arm behind EGM should be by now: law and servo model, stepped as time goes on."""

from __future__ import annotations

import numpy as np

from skewmi.calibration.egm_law import desired_motions
from skewmi.calibration.egm_model import EgmArm
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_prediction import ServoPrediction
from skewmi.robot_models.yumi import Array
from skewmi.trajectory import GRID_S, JointTrajectory


class EgmPrediction:
    """One arm that is asked for motions through EGM; used as `ServoPrediction`.

    The law goes in steps of 4 ms, as commands do, where a controller has cycles of 4.032 ms.

    Args:
        arm: What it is taken to be.
        speed_share: Part of the commands' speed that is sent as speed reference.
        model: Of the servos.

    Attributes:
        servo: Behind the law.
    """

    def __init__(self, arm: EgmArm, speed_share: float, model: ServoModel) -> None:
        self._law, self._share = arm.law, speed_share
        self.servo: DelayedServo = arm.servo
        self._servos = ServoPrediction(arm.servo, model)

    def begin(self, q: Array, commanded: Array) -> None:
        """See `ServoPrediction.begin`."""
        self._desired, self._speed = np.array(commanded, dtype=np.float64), np.zeros(7)
        self._servos.begin(q, commanded)

    def step(self, commands: JointTrajectory) -> Array:
        """See `ServoPrediction.step`."""
        (q,), (v,) = desired_motions(
            [self._law],
            commands.q,
            self._share * commands.v,
            GRID_S,
            start=(self._desired, self._speed),
        )
        if len(commands):
            self._desired, self._speed = q[-1], v[-1]
        return self._servos.step(JointTrajectory(q, v, np.zeros_like(q)))
