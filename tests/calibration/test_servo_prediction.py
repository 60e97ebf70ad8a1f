"""Stepping one command after the other comes to what simulating a whole recording comes to."""

from __future__ import annotations

import numpy as np
import pytest
from calibrations import DrawnRobot

from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_prediction import ServoPrediction
from skewmi.robot_models import yumi
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.trajectory import GRID_S, JointTrajectory


@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_servo_model_whatever_servos_and_parts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = DrawnRobot.draw(rng)
    servo = DelayedServo(robot.parameters(CONTACT_SERVO), robot.delay_ms / 1e3)
    times = np.arange(200) * GRID_S
    rate, size = rng.uniform(2.0, 9.0, 7), rng.uniform(-0.05, 0.05, 7)
    start = np.array(yumi.TABLE_CONFIGURATION)
    q = start + size * (1.0 - np.cos(rate * times[:, None]))
    v = size * rate * np.sin(rate * times[:, None])
    commands = JointTrajectory(q, v, np.zeros_like(q))
    rested = start + rng.uniform(-1e-3, 1e-3, 7)

    model = ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp)
    # Before a recording its first command has been held for ever, as before a prediction.
    whole, _ = model.states([servo], commands, rested)
    prediction = ServoPrediction(servo, model)
    prediction.begin(rested, start)
    cuts = np.unique(rng.integers(1, 199, 20))
    at = 0
    for cut in cuts:
        found = prediction.step(commands.part(slice(at, int(cut))))
        np.testing.assert_allclose(found, whole[0, cut], atol=1e-9)
        at = int(cut)
