"""Efforts tell how much inertia a robot has beside the model's, and so its constants in N m."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibrations import DrawnRobot

from skewmi.calibration.excitation import Excitation
from skewmi.calibration.excitation_choice import excitation_centre
from skewmi.calibration.servo_effort import EffortScale, effort_scale, with_efforts
from skewmi.calibration.servo_estimates import Estimate, estimates
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


def test_a_robot_that_weighs_what_the_model_does_has_its_efforts(recording: ServoRecording) -> None:
    scale = effort_scale(MODEL, TRUTH, [recording])
    np.testing.assert_allclose(scale.value, 1.0, atol=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_efforts_are_as_much_larger_as_everything_that_makes_them(
    recording: ServoRecording, seed: int
) -> None:
    """Inertia, stiffness, damping and friction all larger by a factor give the same motion."""
    rng = np.random.default_rng(seed)
    factor, offset = rng.uniform(0.6, 1.6, 7), rng.normal(0.0, 2.0, 7)
    assert recording.efforts is not None
    efforts = factor * recording.efforts + offset
    efforts = efforts + rng.normal(0.0, 0.05, efforts.shape)
    told = replace(recording, efforts=efforts)
    scale = effort_scale(MODEL, TRUTH, [told])
    np.testing.assert_allclose(scale.value, factor, rtol=0.03)
    assert np.all(np.abs(scale.value / factor - 1.0) < 5.0 * scale.deviation + 0.01)


@pytest.mark.parametrize("ticks", [0, 1, 2, 3])
def test_efforts_may_be_told_some_ticks_late(recording: ServoRecording, ticks: int) -> None:
    simulated = MODEL.torques(TRUTH, recording.commands, recording.start)
    at = np.maximum(np.round(recording.times_s / 0.004).astype(int) - ticks, 0)
    scale = effort_scale(MODEL, TRUTH, [replace(recording, efforts=1.2 * simulated[at])])
    np.testing.assert_allclose(scale.value, 1.2, rtol=1e-6)


def test_recordings_with_different_weights_on_the_arm_agree(recording: ServoRecording) -> None:
    assert recording.efforts is not None
    other = replace(recording, efforts=recording.efforts + 3.0)
    scale = effort_scale(MODEL, TRUTH, [recording, other])
    np.testing.assert_allclose(scale.value, 1.0, atol=0.01)


def test_constants_and_intervals_go_with_the_scale(recording: ServoRecording) -> None:
    found = ServoIdentification(
        servo=TRUTH,
        estimates=identified_exactly(),
        residual_rms=np.zeros(7),
        autocorrelation_time=np.ones(7),
        nominal_rms=1.0,
        seconds_of_motion=5.0,
    )
    factor = np.linspace(0.7, 1.3, 7)
    scaled = with_efforts(found, EffortScale(factor, np.full(7, 0.05)))
    for name in ("kp", "kd", "frictionloss"):
        before, after = found.estimates[name], scaled.estimates[name]
        np.testing.assert_allclose(after.value, factor * before.value)
        half = 1.959964 * 0.05
        assert np.all(after.low <= after.value * np.exp(-half) * (1 + 1e-9) + 0.01 * after.value)
        assert np.all(after.high >= after.value * (1.0 + half) * (1 - 1e-9))
    for name in ("kd_over_kp", "frictionloss_over_kp", "delay"):
        assert scaled.estimates[name] is found.estimates[name]
    assert scaled.servo is found.servo


def identified_exactly() -> dict[str, Estimate]:
    unknowns = ServoUnknowns(CONTACT_SERVO)
    tiny = 1e-8 * np.eye(unknowns.size)
    return dict(estimates(unknowns, unknowns.vector(TRUTH), FitCovariance(tiny, tiny), 0.0))


def test_what_are_no_efforts_is_refused(recording: ServoRecording) -> None:
    with pytest.raises(ConfigurationError, match="leave out --effort"):
        effort_scale(MODEL, TRUTH, [replace(recording, efforts=None)])
    assert recording.efforts is not None
    with pytest.raises(ConfigurationError, match="sign of the positions"):
        effort_scale(MODEL, TRUTH, [replace(recording, efforts=-recording.efforts)])
    with pytest.raises(ConfigurationError, match="must be as the positions"):
        replace(recording, efforts=recording.efforts[:, :3])


@pytest.mark.slow
def test_a_heavier_robot_s_constants_are_found_in_n_m(motion: JointTrajectory) -> None:
    recorded = ROBOT.record(motion, 1e-4, 0, mass_scale=1.3)
    found = identify_servos(MODEL, [recorded], CONTACT_SERVO)
    kp = TRUTH.parameters.kp
    by_positions = np.abs(found.estimates["kp"].value / kp - 1.0)
    scale = effort_scale(MODEL, found.servo, [recorded])
    by_efforts = np.abs(with_efforts(found, scale).estimates["kp"].value / kp - 1.0)
    # The large joints move links; what a wrist moves is nearly all rotor, which is known.
    assert by_positions[:4].max() > 0.12
    assert by_efforts.max() < 0.08
