"""Servos of robots drawn from the documented ranges are found from commands and positions alone."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from calibrations import DrawnRobot

from skewmi.calibration.calibration_file import Calibration
from skewmi.calibration.excitation import Excitation
from skewmi.calibration.excitation_choice import excitation_centre
from skewmi.calibration.servo_identification import identify_servos, position_rms
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_parameters import ServoUnknowns
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.servo_section import servo_section, servo_warnings
from skewmi.errors import ConfigurationError
from skewmi.robot_models import limits
from skewmi.robot_models.servo import CONTACT_SERVO, DEFAULT
from skewmi.trajectory import JointTrajectory

LEAD = CONTACT_SERVO.kd / CONTACT_SERVO.kp
NOISE = 1e-4


@functools.cache
def motion() -> JointTrajectory:
    return Excitation(5.0, 1).motion(excitation_centre(), limits.profile("lab"))


@functools.cache
def model() -> ServoModel:
    return ServoModel(LEAD)


def robot() -> DrawnRobot:
    return DrawnRobot.draw(np.random.default_rng(11))


def truth(drawn: DrawnRobot) -> DelayedServo:
    return DelayedServo(drawn.parameters(CONTACT_SERVO), drawn.delay_ms / 1e3)


def test_the_model_with_a_robots_own_constants_moves_as_the_robot_does() -> None:
    drawn = robot()
    recording = drawn.record(motion(), 0.0, 0)
    assert position_rms(model(), truth(drawn), recording).max() < 5e-6
    # And a delay that is off by half a millisecond shows: states are read, not late sensors.
    off = DelayedServo(truth(drawn).parameters, drawn.delay_ms / 1e3 + 5e-4)
    assert position_rms(model(), off, recording).max() > 2e-5


def test_positions_change_evenly_with_a_delay_between_two_ticks() -> None:
    recording = robot().record(motion(), 0.0, 0)
    delays = (0.008, 0.009, 0.010, 0.011, 0.012)
    servos = [DelayedServo(CONTACT_SERVO, delay) for delay in delays]
    steps = np.diff(model().positions(servos, recording), axis=0)
    size = np.sqrt((steps**2).mean(axis=(1, 2)))
    assert size.max() < 1.02 * size.min()


def test_servos_friction_and_delay_are_found_and_written() -> None:
    drawn = robot()
    recording = drawn.record(motion(), NOISE, 0)
    found = identify_servos(model(), [recording], CONTACT_SERVO)
    true = truth(drawn)
    own, expected = found.servo.parameters, true.parameters
    np.testing.assert_allclose(own.kp, expected.kp, rtol=0.08)
    np.testing.assert_allclose(own.kd, expected.kd, rtol=0.08)
    error = np.abs(own.frictionloss - expected.frictionloss)
    assert (error < np.maximum(0.08 * expected.frictionloss, 0.02)).all()
    assert abs(found.servo.delay_s - true.delay_s) < 5e-4
    np.testing.assert_allclose(own.armature, CONTACT_SERVO.armature)
    # The residual is the noise, and three standard deviations and more hold every truth.
    np.testing.assert_allclose(found.residual_rms, NOISE, rtol=0.25)
    assert found.nominal_rms > 25.0 * found.residual_rms.max()
    for name, values in (("kp", expected.kp), ("kd", expected.kd)):
        estimate = found.estimates[name]
        sigma = (estimate.high - estimate.low) / 2.0 / 1.96
        assert (np.abs(estimate.value - values) < 4.0 * sigma).all()
        assert (estimate.low < estimate.high).all()
        assert all(estimate.identified)
    section = servo_section(found)
    Calibration("2026-01-01T00:00:00Z", "0", section, warnings=servo_warnings(found))
    assert section.delay_ms.value == pytest.approx((1e3 * found.servo.delay_s,))
    assert all(section.armature.assumed)
    assert not any(section.kp.assumed)


def test_vectors_and_servos_are_the_same_thing() -> None:
    for free in (False, True):
        unknowns = ServoUnknowns(CONTACT_SERVO, free)
        servo = truth(robot())
        vector = unknowns.vector(servo)
        low, high = unknowns.bounds()
        assert vector.shape == low.shape == high.shape == (unknowns.size,)
        back = unknowns.servo(vector)
        for name in ("kp", "kd", "frictionloss", "armature", "force_limit"):
            np.testing.assert_allclose(
                getattr(back.parameters, name), getattr(servo.parameters, name), rtol=1e-12
            )
        # What intervals are given of has the derivatives that are stated.
        step = 1e-6 * np.random.default_rng(0).uniform(-1.0, 1.0, unknowns.size)
        moved = unknowns.servo(vector + step)
        stated = unknowns.derivatives(vector)
        friction = moved.parameters.frictionloss - back.parameters.frictionloss
        np.testing.assert_allclose(friction, stated["frictionloss"] @ step, rtol=1e-4, atol=1e-12)
        np.testing.assert_allclose(
            np.log(moved.parameters.kd / back.parameters.kd), stated["kd"] @ step, atol=1e-10
        )
        np.testing.assert_allclose(moved.delay_s - back.delay_s, (stated["delay"] @ step)[0])


def test_recordings_that_tell_nothing_are_refused() -> None:
    resting = JointTrajectory.resting(excitation_centre(), 1000)
    times = np.arange(0.0, 3.9, 0.02)
    positions = np.tile(excitation_centre(), (len(times), 1))
    still = ServoRecording(resting, times, positions)
    with pytest.raises(ConfigurationError, match=r"joints \[1, 2, 3, 4, 5, 6, 7\]"):
        identify_servos(model(), [still], DEFAULT)
    with pytest.raises(ConfigurationError, match="one recording at least"):
        identify_servos(model(), [], DEFAULT)
    for bad in (times[::-1], times * 0.1, times + 10.0, times * np.nan):
        with pytest.raises(ConfigurationError):
            ServoRecording(resting, bad, positions)
    with pytest.raises(ConfigurationError, match=r"must be \(n, 7\)"):
        ServoRecording(resting, times, positions[:, :6])
    with pytest.raises(ConfigurationError, match="begin at rest"):
        ServoRecording(motion().part(slice(500, None)), times, positions)


def test_what_no_servo_is_is_refused() -> None:
    for delay in (-1e-3, 1.0, float("nan")):
        with pytest.raises(ConfigurationError, match="delay"):
            DelayedServo(DEFAULT, delay)
    with pytest.raises(ConfigurationError, match="velocity_lead"):
        ServoModel(np.zeros(6))
    with pytest.raises(ConfigurationError, match="threads"):
        ServoModel(threads=0)
