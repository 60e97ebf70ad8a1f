"""Friction at rest is found where there is some, and takes nothing from the rest of the servos."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from calibrations import DrawnRobot, UnknownToModel

from skewmi.calibration.excitation import Excitation
from skewmi.calibration.excitation_choice import excitation_centre
from skewmi.calibration.servo_fit import ServoFit
from skewmi.calibration.servo_identification import ServoIdentification, identify_servos
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_parameters import STRIBECK_VELOCITY, ServoUnknowns
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.servo_section import servo_warnings
from skewmi.calibration.servo_stiction import fit_stiction
from skewmi.calibration.stiction import Stiction
from skewmi.robot_models import limits
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.trajectory import JointTrajectory

LEAD = CONTACT_SERVO.kd / CONTACT_SERVO.kp
PLAIN = ServoUnknowns(CONTACT_SERVO)
STICKS = UnknownToModel(stiction_scale=1.5, stribeck_velocity=0.08)


@functools.cache
def motion(seconds: float) -> JointTrajectory:
    return Excitation(seconds, 1).motion(excitation_centre(), limits.profile("lab"))


def robot() -> DrawnRobot:
    return DrawnRobot.draw(np.random.default_rng([17, 3]))


def recorded(unknown: UnknownToModel, seconds: float = 5.0) -> ServoRecording:
    return robot().record(motion(seconds), 1e-4, 0, unknown=unknown)


def test_vectors_and_servos_that_stick_are_the_same_thing() -> None:
    unknowns = ServoUnknowns(CONTACT_SERVO, sticks=True)
    rng = np.random.default_rng(0)
    stiction = Stiction(rng.uniform(1e-4, 1e-2, 7), rng.uniform(0.01, 0.4, 7))
    servo = DelayedServo(robot().parameters(CONTACT_SERVO), 0.013, stiction)
    back = unknowns.servo(unknowns.vector(servo))
    assert back.stiction is not None
    np.testing.assert_allclose(back.stiction.angle, stiction.angle, rtol=1e-9)
    np.testing.assert_allclose(back.stiction.velocity, stiction.velocity, rtol=1e-9)
    np.testing.assert_allclose(back.parameters.kp, servo.parameters.kp, rtol=1e-9)
    assert back.delay_s == pytest.approx(0.013)
    # One that does not stick has a speed, too, from which a search can begin.
    none = unknowns.servo(unknowns.vector(DelayedServo(servo.parameters, 0.013)))
    assert none.stiction is not None
    assert (none.stiction.angle == 0.0).all()
    np.testing.assert_allclose(none.stiction.velocity, STRIBECK_VELOCITY)


def test_a_constant_error_of_the_readings_changes_no_residual() -> None:
    recording = recorded(UnknownToModel())
    offset = np.linspace(-0.004, 0.004, 7)
    off = ServoRecording(recording.commands, recording.times_s, recording.positions + offset)
    vector = PLAIN.vector(DelayedServo(robot().parameters(CONTACT_SERVO), robot().delay_ms / 1e3))
    model = ServoModel(LEAD)
    own, other = (ServoFit(model, (r,), PLAIN).squares(vector[:, None]) for r in (recording, off))
    # Where the model's arm rests at first is what was read then; that is left behind at once.
    np.testing.assert_allclose(np.sqrt(other), np.sqrt(own), rtol=0.2)
    assert np.sqrt(other).max() < 2e-4


def test_without_friction_at_rest_none_is_found() -> None:
    recording, model = recorded(UnknownToModel()), ServoModel(LEAD)
    fit = ServoFit(model, (recording,), PLAIN)
    true = DelayedServo(robot().parameters(CONTACT_SERVO), robot().delay_ms / 1e3)
    vector = fit.descended(PLAIN.vector(true), 8)
    residual = fit.residual(vector[:, None])[..., 0]
    assert fit_stiction(model, (recording,), PLAIN, vector, residual) is None


def off_by(found: ServoIdentification, name: str) -> float:
    own = robot().parameters(CONTACT_SERVO)
    true = {
        "kd_over_kp": own.kd / own.kp,
        "frictionloss_over_kp": own.frictionloss / own.kp,
        "delay": np.array([robot().delay_ms / 1e3]),
    }[name]
    estimate = found.estimates[name]
    half = np.maximum((estimate.high - estimate.low) / 2.0, 1e-9)
    return float((np.abs(estimate.value - true) / half).max())


@pytest.mark.slow
@pytest.mark.parametrize("mass_scale", [1.0, 0.9])
def test_joints_that_stick_are_identified_with_what_else_they_have(mass_scale: float) -> None:
    offset = tuple(np.linspace(-0.003, 0.003, 7).tolist())
    unknown = UnknownToModel(mass_scale, 1.5, 0.08, offset)
    found = identify_servos(
        ServoModel(LEAD), [recorded(unknown, 20.0)], CONTACT_SERVO, inertia_uncertainty=0.1
    )
    # Twice a 95 % interval at most: 15 numbers are looked at.
    for name in ("kd_over_kp", "frictionloss_over_kp", "delay"):
        assert off_by(found, name) < 2.0, name
    assert abs(1e3 * found.servo.delay_s - robot().delay_ms) < 0.5
    assert found.servo.stiction is not None
    own = robot().parameters(CONTACT_SERVO)
    more = found.servo.parameters.kp * found.servo.stiction.angle
    strong = own.frictionloss > 0.3
    if mass_scale != 1.0:
        # What a wrong mass leaves is in the friction of the joints that carry it.
        strong[:4] = False
    assert strong.sum() > 1
    np.testing.assert_allclose(more[strong], 0.5 * own.frictionloss[strong], rtol=0.2)
    told = [warning for warning in servo_warnings(found) if " sticks: " in warning]
    assert len(told) >= strong.sum()
