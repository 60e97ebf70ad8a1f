"""Law and lag of an emulated controller are found, and a search that shares no code finds the same.

The emulator runs without a network and without waiting; only its settings are known to the tests.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from egm_arms import PERIOD_S, DrawnEgm

from skewmi.calibration.calibration_file import Calibration
from skewmi.calibration.egm_identification import EgmIdentifier
from skewmi.calibration.egm_law import EgmLaw
from skewmi.calibration.egm_model import EgmRecording
from skewmi.calibration.egm_section import egm_arm, egm_section, egm_warnings, law_is_known
from skewmi.calibration.excitation import Excitation
from skewmi.calibration.excitation_choice import excitation_centre
from skewmi.calibration.servo_model import ServoModel
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.errors import ConfigurationError
from skewmi.robot_models import limits
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.trajectory import GRID_S, JointTrajectory

ANNOUNCED = EgmLaw(20.0, 20.0)
NOISE = 1e-4
ROBOT: dict[str, object] = {
    "seed": 0,
    "servo": {"frictionloss": CONTACT_SERVO.frictionloss.tolist()},
}
"""Nominal servos, with dry friction as those of all variations have it."""


@functools.cache
def motion() -> JointTrajectory:
    asked = Excitation(5.0, 1, tcp_speed=0.18)
    return asked.motion(excitation_centre(), limits.profile("lab"))


@functools.cache
def model() -> ServoModel:
    return ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp)


@pytest.mark.slow
def test_law_and_lag_of_an_emulated_controller_are_found_and_written() -> None:
    drawn = DrawnEgm(EgmLaw(8.0, 12.0), 17.3)
    recording = drawn.record(motion(), NOISE, 0, ROBOT)
    # The bridge was told another law: what is announced is where the search begins, no more.
    found = EgmIdentifier(model(), [recording], CONTACT_SERVO, ANNOUNCED).run()
    truths = {"gain": 8.0, "low_pass": 12.0, "delay": drawn.delay_s}
    for name, true in truths.items():
        estimate = found.estimates[name]
        sigma = (estimate.high - estimate.low) / 2.0 / 1.96
        assert abs(estimate.value[0] - true) < 4.0 * sigma[0], name
        assert estimate.identified == (True,)
    assert found.nominal_rms > 10.0 * found.residual_rms.max()
    assert law_is_known(found)
    section = egm_section(found)
    written = Calibration("2026-01-01T00:00:00Z", "0", egm=section, warnings=egm_warnings(found))
    assert Calibration.of_mapping(written.as_mapping()) == written
    back = egm_arm(section, CONTACT_SERVO)
    assert back.law == found.arm.law
    assert section.period_ms == pytest.approx(1e3 * PERIOD_S)
    # Servos with the velocity feed-forward that they are taken to have are not late by themselves.
    np.testing.assert_allclose(section.lag_ms.value, drawn.lag_ms, atol=2.0)


@pytest.mark.slow
def test_trying_every_lag_and_corner_on_the_emulator_itself_finds_the_same() -> None:
    drawn = DrawnEgm(EgmLaw(20.0, 9.0), 11.0)
    recording = drawn.record(motion(), NOISE, 5, ROBOT)
    found = EgmIdentifier(model(), [recording], CONTACT_SERVO, ANNOUNCED).run()
    lags, corners = 11.0 + np.arange(-1.0, 2.0), 9.0 * 1.06 ** np.arange(-1.0, 2.0)
    size = np.array(
        [
            [_far(DrawnEgm(EgmLaw(20.0, corner), lag), recording) for corner in corners]
            for lag in lags
        ]
    )
    # Least squares of a quadratic through all nine: where its minimum is, without a fitter.
    u, w = np.meshgrid(np.arange(-1.0, 2.0), np.arange(-1.0, 2.0), indexing="ij")
    rows = np.stack(
        (np.ones(9), u.ravel(), w.ravel(), u.ravel() ** 2, (u * w).ravel(), w.ravel() ** 2)
    )
    c = np.linalg.lstsq(rows.T, size.ravel(), rcond=None)[0]
    best = np.linalg.solve([[2 * c[3], c[4]], [c[4], 2 * c[5]]], [-c[1], -c[2]])
    assert np.abs(best).max() < 1.0, "the minimum is not where the truth is"
    lag_ms = 11.0 + best[0] + 1e3 * PERIOD_S
    corner_hz = 9.0 * 1.06 ** best[1]
    assert abs(1e3 * found.estimates["delay"].value[0] - lag_ms) < 0.3
    assert found.estimates["low_pass"].value[0] == pytest.approx(corner_hz, rel=0.02)


def _far(tried: DrawnEgm, recording: EgmRecording) -> float:
    """Squared difference of an emulated arm's way and a recorded one."""
    error = tried.record(motion(), variation=ROBOT).motion.positions - recording.motion.positions
    return float((error[200:] ** 2).sum())


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
