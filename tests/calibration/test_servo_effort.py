"""Efforts tell how much inertia a robot has beside the model's, and so its constants in N m."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibrations import DrawnRobot, UnknownToModel

from skewmi.calibration.excitation import Excitation
from skewmi.calibration.excitation_choice import excitation_centre
from skewmi.calibration.servo_effort import EffortFit, fit_efforts, with_efforts
from skewmi.calibration.servo_estimates import estimates
from skewmi.calibration.servo_identification import ServoIdentification, identify_servos
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_parameters import ServoUnknowns
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.uncertainty import FitCovariance
from skewmi.errors import ConfigurationError
from skewmi.robot_models import limits
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.trajectory import JointTrajectory

MODEL = ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp)
ROBOT = DrawnRobot.draw(np.random.default_rng(11))
TRUTH = DelayedServo(ROBOT.parameters(CONTACT_SERVO), ROBOT.delay_ms / 1e3)


@pytest.fixture(scope="module")
def motion() -> JointTrajectory:
    return Excitation(5.0, 1).motion(excitation_centre(), limits.profile("lab"))


@pytest.fixture(scope="module")
def recording(motion: JointTrajectory) -> ServoRecording:
    return ROBOT.record(motion, 0.0, 0)


def test_stiffness_and_damping_are_those_of_the_robot(recording: ServoRecording) -> None:
    fit = fit_efforts(MODEL, TRUTH, [recording])
    np.testing.assert_allclose(fit.kp, TRUTH.parameters.kp, rtol=0.01)
    np.testing.assert_allclose(fit.kd, TRUTH.parameters.kd, rtol=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_what_the_model_takes_for_masses_does_not_count(
    recording: ServoRecording, seed: int
) -> None:
    """Inertia, stiffness, damping and friction all larger by a factor give the same motion."""
    rng = np.random.default_rng(seed)
    factor, offset = rng.uniform(0.6, 1.6, 7), rng.normal(0.0, 0.5, 7)
    assert recording.efforts is not None
    efforts = factor * recording.efforts + offset
    told = replace(recording, efforts=efforts + rng.normal(0.0, 0.05, efforts.shape))
    fit = fit_efforts(MODEL, TRUTH, [told])
    own = TRUTH.parameters
    for found, deviation, true in (
        (fit.kp, fit.kp_deviation, factor * own.kp),
        (fit.kd, fit.kd_deviation, factor * own.kd),
    ):
        np.testing.assert_allclose(found, true, rtol=0.1)
        assert np.all(np.abs(found / true - 1.0) < 5.0 * deviation + 0.01)


@pytest.mark.parametrize("ticks", [0, 1, 2, 3])
def test_efforts_may_be_told_some_ticks_late(recording: ServoRecording, ticks: int) -> None:
    error, velocity = MODEL.errors(TRUTH, recording.commands, recording.start)
    at = np.maximum(np.round(recording.times_s / 0.004).astype(int) - ticks, 0)
    told = replace(recording, efforts=10.0 * error[at] - 2.0 * velocity[at])
    fit = fit_efforts(MODEL, TRUTH, [told])
    np.testing.assert_allclose(fit.kp, 10.0, rtol=2e-3)
    np.testing.assert_allclose(fit.kd, 2.0, rtol=2e-3)


def test_recordings_with_different_weights_on_the_arm_agree(recording: ServoRecording) -> None:
    assert recording.efforts is not None
    other = replace(recording, efforts=recording.efforts + 0.5)
    fit = fit_efforts(MODEL, TRUTH, [recording, other])
    np.testing.assert_allclose(fit.kp, TRUTH.parameters.kp, rtol=0.01)


def test_constants_and_intervals_are_those_of_the_efforts() -> None:
    unknowns = ServoUnknowns(CONTACT_SERVO)
    tiny = 1e-8 * np.eye(unknowns.size)
    exact = estimates(unknowns, unknowns.vector(TRUTH), FitCovariance(tiny, tiny), 0.3)
    found = ServoIdentification(TRUTH, exact, np.zeros(7), np.ones(7), 1.0, 5.0)
    own, factor = TRUTH.parameters, np.linspace(0.7, 1.3, 7)
    part = np.full(7, 0.05)
    told = with_efforts(found, EffortFit(factor * own.kp, part, own.kd / factor, part)).estimates
    np.testing.assert_allclose(told["kp"].value, factor * own.kp)
    np.testing.assert_allclose(told["kd"].value, own.kd / factor)
    np.testing.assert_allclose(told["frictionloss"].value, factor * own.frictionloss)
    # Two standard deviations; what positions did not know of the inertia is not in it.
    np.testing.assert_allclose(told["kp"].high / told["kp"].value, np.exp(1.96 * 0.05), rtol=1e-3)
    half = (told["frictionloss"].high - told["frictionloss"].value) / told["frictionloss"].value
    np.testing.assert_allclose(half, 1.96 * 0.05, rtol=0.05)
    for name in ("kd_over_kp", "frictionloss_over_kp", "delay"):
        assert told[name] is exact[name]


def test_what_are_no_efforts_is_refused(recording: ServoRecording) -> None:
    with pytest.raises(ConfigurationError, match="leave out --effort"):
        fit_efforts(MODEL, TRUTH, [replace(recording, efforts=None)])
    assert recording.efforts is not None
    with pytest.raises(ConfigurationError, match="sign of the positions"):
        fit_efforts(MODEL, TRUTH, [replace(recording, efforts=-recording.efforts)])
    with pytest.raises(ConfigurationError, match="at its force limit"):
        fit_efforts(MODEL, TRUTH, [replace(recording, efforts=100.0 * recording.efforts + 1e3)])
    with pytest.raises(ConfigurationError, match="must be as the positions"):
        replace(recording, efforts=recording.efforts[:, :3])


@pytest.mark.slow
def test_a_heavier_robot_s_constants_are_found_in_n_m() -> None:
    motion = Excitation(12.0, 1).motion(excitation_centre(), limits.profile("lab"))
    recorded = ROBOT.record(motion, 1e-4, 0, unknown=UnknownToModel(mass_scale=1.15))
    found = identify_servos(MODEL, [recorded], CONTACT_SERVO)
    fit = fit_efforts(MODEL, found.servo, [recorded])
    own = TRUTH.parameters
    assert np.abs(found.estimates["kp"].value / own.kp - 1.0).max() > 0.1
    np.testing.assert_allclose(fit.kp, own.kp, rtol=0.03)
    np.testing.assert_allclose(fit.kd, own.kd, rtol=0.05)
