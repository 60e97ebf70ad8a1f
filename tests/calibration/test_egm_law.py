"""The law that identification reckons with is the emulated controller's, and time may be scaled."""

from __future__ import annotations

from itertools import pairwise
from math import pi

import numpy as np
import pytest
from egm_arms import PERIOD_S, DrawnEgm
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.calibration.egm_law import EgmLaw, desired_motions
from skewmi.calibration.egm_model import EgmArm, EgmModel, EgmRecording
from skewmi.calibration.egm_parameters import EgmUnknowns
from skewmi.calibration.egm_prediction import EgmPrediction
from skewmi.calibration.excitation_choice import excitation_centre
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.deploy.robot.backends.egm.packets import ReferencePacket
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.egm_emulator.control_law import ControlLaw
from skewmi.errors import ConfigurationError
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.trajectory import GRID_S, JointTrajectory

LEAD = CONTACT_SERVO.kd / CONTACT_SERVO.kp
laws = st.builds(EgmLaw, st.floats(0.5, 20.0), st.floats(0.5, 100.0))


@settings(max_examples=20)
@given(laws, st.floats(0.0, 0.05), st.integers(0, 2**32 - 1))
def test_every_law_wants_what_the_emulated_controller_wants(
    law: EgmLaw, lag_s: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    q = np.cumsum(rng.uniform(-1e-3, 1e-3, (60, 7)), axis=0)
    v = rng.uniform(-0.2, 0.2, (60, 7))
    program = ProgramSettings(
        gain=law.gain,
        low_pass_hz=law.low_pass_hz,
        ramp_in_s=0.005,
        max_speed_deviation_deg_s=1e4,
    )
    emulated = ControlLaw(program, q[0], PERIOD_S, lag_s)
    for _ in range(2):  # Ramped in, and still at rest.
        emulated.step(ReferencePacket(0, 0, q[0], np.zeros(7)))
    (desired,), (speed,) = desired_motions([law], q, v, PERIOD_S)
    for index in range(len(q)):
        target = emulated.step(ReferencePacket(0, 0, q[index], v[index]))
        np.testing.assert_allclose(desired[index], emulated.desired, atol=1e-12)
        np.testing.assert_allclose(speed[index], emulated.speed, atol=1e-9)
        # And the servos get it the lag later, between two cycles linearly.
        late = max(index - lag_s / PERIOD_S, 0.0)
        expected = [np.interp(late, np.arange(len(q)), column) for column in desired.T]
        if index >= lag_s / PERIOD_S:
            np.testing.assert_allclose(target.q, expected, atol=1e-12)


@given(laws, st.floats(0.0, 0.1), st.floats(0.5, 2.0))
def test_time_that_passes_slower_and_faster_again_is_the_same(
    law: EgmLaw, delay_s: float, factor: float
) -> None:
    arm = EgmArm(law, DelayedServo(CONTACT_SERVO, delay_s))
    back = arm.slower(factor).slower(1.0 / factor)
    assert back.law.gain == pytest.approx(law.gain)
    assert back.law.low_pass_hz == pytest.approx(law.low_pass_hz)
    assert back.servo.delay_s == pytest.approx(delay_s)
    np.testing.assert_allclose(back.servo.parameters.kp, CONTACT_SERVO.kp)
    np.testing.assert_allclose(back.servo.parameters.kd, CONTACT_SERVO.kd)
    # What has no time in it stays: how far friction holds a joint off.
    slower = arm.slower(factor).servo.parameters
    np.testing.assert_allclose(
        slower.frictionloss / slower.kp, CONTACT_SERVO.frictionloss / CONTACT_SERVO.kp
    )


@settings(max_examples=30)
@given(laws, st.integers(0, 2**32 - 1))
def test_vectors_and_arms_are_the_same_thing(law: EgmLaw, seed: int) -> None:
    rng = np.random.default_rng(seed)
    servo = CONTACT_SERVO.with_changes(
        kp=CONTACT_SERVO.kp * rng.uniform(0.6, 1.8, 7),
        kd=CONTACT_SERVO.kd * rng.uniform(0.6, 1.8, 7),
        frictionloss=rng.uniform(0.0, 2.0, 7),
    )
    unknowns = EgmUnknowns(CONTACT_SERVO, EgmLaw(20.0, 20.0), LEAD)
    arm = EgmArm(law, DelayedServo(servo, float(rng.uniform(0.0, 0.1))))
    vector = unknowns.vector(arm)
    low, high = unknowns.bounds()
    assert vector.shape == low.shape == high.shape == (unknowns.size,)
    assert ((low <= vector) & (vector <= high)).all()
    back = unknowns.arm(vector)
    assert back.law.gain == pytest.approx(law.gain)
    assert back.law.low_pass_hz == pytest.approx(law.low_pass_hz)
    np.testing.assert_allclose(back.servo.parameters.kd, servo.kd)
    # What intervals are given of has the derivatives that are stated.
    step = 1e-6 * rng.uniform(-1.0, 1.0, unknowns.size)
    moved, stated = unknowns.arm(vector + step), unknowns.derivatives(vector)
    np.testing.assert_allclose(
        np.log(moved.law.gain / back.law.gain), (stated["gain"] @ step)[0], atol=1e-10
    )
    np.testing.assert_allclose(
        np.log(moved.law.low_pass_hz / back.law.low_pass_hz),
        (stated["low_pass"] @ step)[0],
        atol=1e-10,
    )
    change = unknowns.lags(vector + step) - unknowns.lags(vector)
    np.testing.assert_allclose(change, stated["lag"] @ step, atol=1e-10)


def test_an_arm_at_a_steady_speed_is_behind_by_its_lag() -> None:
    law, delay_s, speed = EgmLaw(10.0, 20.0), 0.018, 0.1
    servo = CONTACT_SERVO.with_changes(kd=1.5 * CONTACT_SERVO.kd, frictionloss=np.zeros(7))
    unknowns = EgmUnknowns(CONTACT_SERVO, law, LEAD)
    arm = EgmArm(law, DelayedServo(servo, delay_s))
    lags = unknowns.lags(unknowns.vector(arm))
    times = GRID_S * np.arange(750)
    # The speed comes on within half a second, so that nothing rings.
    v = speed * (0.5 - 0.5 * np.cos(pi * np.minimum(times / 0.5, 1.0)))
    q = np.cumsum(v) * GRID_S
    motion = JointTrajectory(
        excitation_centre() + np.tile(q[:, None], (1, 7)),
        np.tile(v[:, None], (1, 7)),
        np.zeros((750, 7)),
    )
    recording = ServoRecording(motion, times, motion.q)
    (positions,) = EgmModel(ServoModel(LEAD), 1.0).positions([arm], recording)
    behind = (motion.q[-1] - positions[-1]) / speed
    # Turning joints pull at one another while they do.
    np.testing.assert_allclose(behind, lags, atol=2e-3)
    assert (lags > 0.014).all()


def test_prediction_step_by_step_is_the_simulation_of_the_whole() -> None:
    rng = np.random.default_rng(3)
    q = excitation_centre() + 1e-3 * np.cumsum(np.cumsum(rng.uniform(-0.1, 0.1, (80, 7)), 0), 0)
    q[0] = excitation_centre()
    v = np.gradient(q, GRID_S, axis=0)
    v[0] = 0.0
    motion = JointTrajectory(q, v, np.zeros_like(q))
    arm = EgmArm(EgmLaw(7.0, 12.0), DelayedServo(CONTACT_SERVO, 0.0143))
    model = ServoModel(LEAD)
    times = GRID_S * np.arange(80)
    recording = object.__new__(ServoRecording)  # Shorter than any recording may be.
    for name, value in (
        ("commands", motion),
        ("times_s", times),
        ("positions", np.tile(q[0], (80, 1))),
    ):
        object.__setattr__(recording, name, value)
    (expected,) = EgmModel(model, 0.7).positions([arm], recording)
    prediction = EgmPrediction(arm, 0.7, model)
    prediction.begin(q[0], q[0])
    cuts = [0, 1, 1, 6, 11, 30, 79]
    for start, end in pairwise(cuts):
        predicted = prediction.step(motion.part(slice(start, end)))
        np.testing.assert_allclose(predicted, expected[end], atol=1e-12)


def test_what_no_law_and_no_recording_is_is_refused() -> None:
    for bad in (0.0, -1.0, float("nan"), 1e4):
        with pytest.raises(ConfigurationError, match="gain"):
            EgmLaw(bad, 20.0)
        with pytest.raises(ConfigurationError, match="low_pass_hz"):
            EgmLaw(20.0, bad)
    motion = DrawnEgm(EgmLaw(20.0, 20.0), 0.0)
    resting = JointTrajectory.resting(excitation_centre(), 1000)
    good = ServoRecording(resting, GRID_S * np.arange(1000), resting.q)
    assert motion.delay_s == PERIOD_S
    with pytest.raises(ConfigurationError, match="cycles of 0"):
        EgmRecording(good, 1e-6, 1.0)
    with pytest.raises(ConfigurationError, match="share"):
        EgmRecording(good, PERIOD_S, 1.1)
