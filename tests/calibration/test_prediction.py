"""Predicted half-widths are what fits of many noisy recordings scatter by."""

from __future__ import annotations

import numpy as np

from skewmi.calibration.excitation import Excitation
from skewmi.calibration.excitation_choice import excitation_centre
from skewmi.calibration.prediction import predicted_half_width
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_parameters import ServoUnknowns
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.robot_models import limits
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.trajectory import CYCLE_TICKS, GRID_S, JointTrajectory

SERVO = DelayedServo(CONTACT_SERVO, 0.02)
NOISE = 1e-4


def motion(seconds: float, profile: str = "lab") -> JointTrajectory:
    return Excitation(seconds, 0).motion(excitation_centre(), limits.profile(profile))


def test_a_linear_fit_scatters_as_predicted() -> None:
    model = ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp)
    excitation = motion(6.0)
    predicted = predicted_half_width(model, excitation, SERVO, NOISE)
    unknowns = ServoUnknowns(CONTACT_SERVO)
    vector = unknowns.vector(SERVO)
    times = GRID_S * np.arange(0.0, len(excitation), CYCLE_TICKS)
    recording = ServoRecording(excitation, times, np.tile(excitation.q[0], (len(times), 1)))
    step = 1e-4 * np.eye(unknowns.size)
    servos = [unknowns.servo(row) for row in (*(vector + step), *(vector - step))]
    positions = model.positions(servos, recording)
    jacobian = ((positions[:22] - positions[22:]) / 2e-4).reshape(22, -1).T
    rng = np.random.default_rng(3)
    noise = NOISE * rng.standard_normal((jacobian.shape[0], 400))
    fitted = np.linalg.lstsq(jacobian, noise, rcond=None)[0]
    derivatives = unknowns.derivatives(vector)
    for name in ("kp", "kd", "frictionloss"):
        scatter = 1.96 * (derivatives[name] @ fitted).std(axis=1)
        np.testing.assert_allclose(getattr(predicted, name), scatter, rtol=0.25)
    scatter = 1e3 * 1.96 * float((derivatives["delay"] @ fitted).std())
    assert abs(predicted.delay_ms / scatter - 1.0) < 0.25


def test_longer_and_faster_motions_tell_more() -> None:
    model = ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp)
    worst = [
        predicted_half_width(model, m, SERVO).worst
        for m in (motion(12.0), motion(6.0), motion(6.0, "careful"))
    ]
    assert worst == sorted(worst)
