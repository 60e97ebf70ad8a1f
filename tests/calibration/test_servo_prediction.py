"""Stepping one command after the other comes to what simulating a whole recording comes to."""

from __future__ import annotations

import numpy as np
import pytest
from calibrations import DrawnRobot, UnknownToModel
from scipy.interpolate import CubicSpline

from skewmi.calibration.excitation import Excitation
from skewmi.calibration.excitation_choice import excitation_centre
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_prediction import ServoPrediction
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.stiction import Stiction
from skewmi.robot_models import limits, yumi
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


def test_joints_that_stick_are_followed_as_a_simulation_that_sets_friction_tick_by_tick() -> None:
    drawn = DrawnRobot.draw(np.random.default_rng([17, 1]))
    own = drawn.parameters(CONTACT_SERVO)
    motion = Excitation(5.0, 1).motion(excitation_centre(), limits.profile("lab"))
    unknown = UnknownToModel(stiction_scale=1.5, stribeck_velocity=0.1)
    recording = drawn.record(motion, 0.0, 0, unknown=unknown)
    stiction = Stiction(0.5 * own.frictionloss / own.kp, np.full(7, 0.1))
    model = ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp)
    off = {}
    for name, sticks in (("told", stiction), ("not told", None)):
        prediction = ServoPrediction(DelayedServo(own, drawn.delay_ms / 1e3, sticks), model)
        prediction.begin(motion.q[0], motion.q[0])
        every = range(1, len(motion), 5)
        found = [prediction.step(motion.part(slice(max(k - 5, 0), k))) for k in every]
        # After k commands it is where the simulation is at tick k.
        measured = between(recording, np.array(every) * GRID_S)
        off[name] = np.sqrt(((np.array(found) - measured) ** 2).mean(axis=0))
    assert (off["told"] < np.maximum(off["not told"] / 3.0, 3e-5)).all(), off
    assert off["not told"].max() > 3e-4


def between(recording: ServoRecording, times_s: np.ndarray) -> np.ndarray:
    """Measured positions at other times, by splines. Shape (m, 7)."""
    spline = CubicSpline(recording.times_s, recording.positions)
    return np.asarray(spline(times_s))
