"""The servo model moves as joints do whose friction falls with speed."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from calibrations import DrawnRobot, UnknownToModel

from skewmi.calibration.excitation import Excitation
from skewmi.calibration.excitation_choice import excitation_centre
from skewmi.calibration.servo_identification import position_rms
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.stiction import Stiction
from skewmi.robot_models import limits
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.trajectory import JointTrajectory

LEAD = CONTACT_SERVO.kd / CONTACT_SERVO.kp


@functools.cache
def motion() -> JointTrajectory:
    return Excitation(5.0, 1).motion(excitation_centre(), limits.profile("lab"))


def robot(seed: int) -> DrawnRobot:
    return DrawnRobot.draw(np.random.default_rng([17, seed]))


def sticking(drawn: DrawnRobot, scale: float, speed: float) -> DelayedServo:
    own = drawn.parameters(CONTACT_SERVO)
    angle = (scale - 1.0) * own.frictionloss / own.kp
    return DelayedServo(own, drawn.delay_ms / 1e3, Stiction(angle, np.full(7, speed)))


@pytest.mark.parametrize(
    ("seed", "scale", "speed"), [(0, 1.9, 0.015), (1, 1.5, 0.1), (2, 1.8, 0.2)]
)
def test_the_model_moves_as_a_simulation_that_sets_friction_tick_by_tick(
    seed: int, scale: float, speed: float
) -> None:
    drawn, model = robot(seed), ServoModel(LEAD)
    unknown = UnknownToModel(stiction_scale=scale, stribeck_velocity=speed)
    recording = drawn.record(motion(), 0.0, 0, unknown=unknown)
    plain = DelayedServo(drawn.parameters(CONTACT_SERVO), drawn.delay_ms / 1e3)
    without = position_rms(model, plain, recording)
    told = position_rms(model, sticking(drawn, scale, speed), recording)
    assert without.max() > 3e-4
    assert (told < 5e-6).all(), (told, without)


def test_candidates_that_stick_and_others_do_not_meet() -> None:
    drawn, model = robot(1), ServoModel(LEAD)
    sticks = sticking(drawn, 1.5, 0.1)
    plain = DelayedServo(sticks.parameters, sticks.delay_s)
    start = motion().q[0]
    both, _ = model.states([plain, sticks, plain], motion(), start)
    np.testing.assert_array_equal(both[0], model.states([plain], motion(), start)[0][0])
    np.testing.assert_array_equal(both[1], model.states([sticks], motion(), start)[0][0])
    np.testing.assert_array_equal(both[0], both[2])


def test_nothing_more_at_rest_is_nothing() -> None:
    drawn, model = robot(2), ServoModel(LEAD)
    start = motion().q[0]
    servo = sticking(drawn, 1.0, 0.1)
    plain = DelayedServo(servo.parameters, servo.delay_s)
    for found, expected in zip(
        model.states([servo], motion(), start), model.states([plain], motion(), start), strict=True
    ):
        np.testing.assert_allclose(found, expected, atol=1e-9)
