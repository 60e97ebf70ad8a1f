"""The search for servos ends in the minimum, or says that there are two."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from calibrations import DrawnRobot, UnknownToModel

from skewmi.calibration.excitation import Excitation
from skewmi.calibration.excitation_choice import excitation_centre
from skewmi.calibration.servo_fit import ServoFit
from skewmi.calibration.servo_identification import identify_servos
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_parameters import DELAY_UNIT_S, ServoUnknowns
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.servo_rivals import TOLD_APART, likely, losses
from skewmi.calibration.servo_search import beginning
from skewmi.calibration.servo_starts import best_joints, later
from skewmi.calibration.uncertainty import TWO_SIDED_95
from skewmi.robot_models import limits
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.robot_models.yumi import Array
from skewmi.trajectory import JointTrajectory

LEAD = CONTACT_SERVO.kd / CONTACT_SERVO.kp
UNKNOWNS = ServoUnknowns(CONTACT_SERVO)
MASS_ERROR = 0.15


@functools.cache
def motion() -> JointTrajectory:
    return Excitation(5.0, 1).motion(excitation_centre(), limits.profile("lab"))


@functools.cache
def light_robot() -> tuple[DrawnRobot, ServoRecording]:
    """One whose arm weighs a ninth less than the model's, and how it moves."""
    drawn = DrawnRobot.draw(np.random.default_rng([0, 4]))
    return drawn, drawn.record(motion(), 1e-4, 0, unknown=UnknownToModel(mass_scale=0.887))


@pytest.mark.slow
def test_joints_that_make_up_for_a_wrong_delay_do_not_hold_it() -> None:
    drawn, recording = light_robot()
    true = drawn.parameters(CONTACT_SERVO)
    lead = true.kd / true.kp
    # A minimum of each joint at a delay that is 4 ms off: stiffer, and less damping to it.
    kp = true.kp * np.array([1.7, 4.9, 1.4, 1.5, 2.1, 6.0, 2.3])
    kd = kp * lead * np.array([0.93, 0.9, 0.94, 0.95, 0.36, 0.34, 0.55])
    wrong = true.with_changes(kp=kp, kd=kd, frictionloss=true.frictionloss / true.kp * kp)
    found = identify_servos(
        ServoModel(LEAD),
        [recording],
        CONTACT_SERVO,
        inertia_uncertainty=MASS_ERROR / 3.0**0.5,
        start=DelayedServo(wrong, drawn.delay_ms / 1e3 + 0.0039),
    )
    assert abs(1e3 * found.servo.delay_s - drawn.delay_ms) < 0.4
    own = found.servo.parameters
    np.testing.assert_allclose((own.kd / own.kp)[4:], lead[4:], rtol=0.1)
    for name, values in (("kd_over_kp", lead), ("delay", np.array([drawn.delay_ms / 1e3]))):
        estimate = found.estimates[name]
        # Twice a 95 % interval: no joint of a hundred is beyond it by chance.
        half = estimate.high - estimate.low
        assert (np.abs(estimate.value - values) < half).all()


@pytest.mark.parametrize("difference", [0.0, 2e-3])
def test_an_interval_holds_both_minima_that_the_data_do_not_tell_apart(
    monkeypatch: pytest.MonkeyPatch, difference: float
) -> None:
    rng = np.random.default_rng(3)
    noise = 1e-4 * rng.standard_normal((300, 7, 1))
    shapes = rng.standard_normal((5, 300, 7, 1))

    def residual(_: ServoFit, vectors: Array) -> Array:
        """Of arms that fit with half and with twice the stiffness alike, but for a difference."""
        # Friction at rest is nothing that these arms have.
        stiffness, damping, friction = vectors[:21].reshape(3, 7, -1)
        off = 1e-3 * (stiffness**2 - np.log(2.0) ** 2) * shapes[0]
        off += 1e-3 * damping * shapes[1] + 1e-3 * (friction - 1.0) * shapes[2]
        off += 1e-3 * (vectors[-1] - 2.0) * shapes[3]
        simulated: Array = noise + off + difference * (stiffness < 0.0) * shapes[4]
        return simulated

    monkeypatch.setattr(ServoFit, "residual", residual)
    # From the wrong one, if one is wrong.
    start = CONTACT_SERVO.with_changes(kp=0.5 * CONTACT_SERVO.kp, kd=0.5 * CONTACT_SERVO.kd)
    found = identify_servos(
        ServoModel(LEAD), [light_robot()[1]], CONTACT_SERVO, start=DelayedServo(start, 0.02)
    )
    kp = found.estimates["kp"]
    holds = [(kp.low < f * CONTACT_SERVO.kp) & (f * CONTACT_SERVO.kp < kp.high) for f in (0.5, 2.0)]
    told = difference > 0.0
    assert (holds[0] != told).all()
    assert all(known == told for known in kp.identified)
    assert all(found.estimates["kd_over_kp"].identified)
    if told:
        np.testing.assert_allclose(kp.value, 2.0 * CONTACT_SERVO.kp, rtol=0.02)
    else:
        assert holds[1].all()


def test_an_interval_holds_what_other_weights_of_a_wrong_model_find(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(4)
    residuals = 1e-4 * rng.standard_normal((600, 7, 1))
    # Joints that carry a wrong mass: of another size, and over many samples.
    slow = rng.standard_normal((619, 4))
    residuals[:, :4, 0] += 3e-4 * np.array([np.convolve(c, np.ones(20), "valid") for c in slow.T]).T
    shapes = rng.standard_normal((4, 600, 7, 1)).cumsum(axis=1) / 20.0

    def residual(_: ServoFit, vectors: Array) -> Array:
        parts = np.concatenate((vectors[:21].reshape(3, 7, -1), np.tile(vectors[-1], (1, 7, 1))))
        simulated: Array = residuals + 1e-3 * ((parts - 1.0)[:, None] * shapes).sum(axis=0)
        return simulated

    monkeypatch.setattr(ServoFit, "residual", residual)
    model, recordings = ServoModel(LEAD), [light_robot()[1]]
    found = identify_servos(model, recordings, CONTACT_SERVO)
    fit, vector = ServoFit(model, recordings, UNKNOWNS), UNKNOWNS.vector(found.servo)
    at_best = fit.residual(vector[:, None])[..., 0]
    other = fit.minimised(vector, 1.0 / fit.sigma(at_best), 20)
    apart = abs(UNKNOWNS.servo(other).delay_s - found.servo.delay_s)
    alone = fit.covariance(vector, at_best).deviations(np.eye(UNKNOWNS.size))[-1] * DELAY_UNIT_S
    delay = found.estimates["delay"]
    assert apart > 1e-6
    assert delay.high[0] - delay.value[0] >= 0.99 * (apart + TWO_SIDED_95 * alone)


def test_more_delay_takes_its_lag_from_the_damping() -> None:
    servo = DelayedServo(CONTACT_SERVO, 0.02)
    vector = UNKNOWNS.vector(servo)
    for delay in (-0.005, 0.002):
        other = UNKNOWNS.servo(later(UNKNOWNS, vector, delay))
        assert other.delay_s == pytest.approx(0.02 + delay)
        own = other.parameters
        np.testing.assert_allclose(own.kd / own.kp + delay, LEAD, rtol=1e-9)
        np.testing.assert_allclose(own.kp, CONTACT_SERVO.kp, rtol=1e-12)
    low, high = UNKNOWNS.bounds()
    for delay in (-1.0, 1.0):
        other_vector = later(UNKNOWNS, vector, delay)
        assert ((low <= other_vector) & (other_vector <= high)).all()


def test_each_joint_gets_the_numbers_of_the_column_that_suits_it() -> None:
    vectors = np.tile(np.arange(4.0), (UNKNOWNS.size, 1))
    vectors[-1] = [5.0, 5.0, 7.0, 7.0]
    squares = np.full((7, 4), 2.0)
    squares[[0, 3], [1, 1]] = 1.0
    squares[6, 3] = 0.5
    mixed, own = best_joints(vectors, squares, [[0, 1], range(2, 4)])
    for kind in range(3):
        np.testing.assert_array_equal(mixed[7 * kind : 7 * kind + 7, 0], [1, 0, 0, 1, 0, 0, 0])
        np.testing.assert_array_equal(mixed[7 * kind : 7 * kind + 7, 1], [2, 2, 2, 2, 2, 2, 3])
    np.testing.assert_array_equal(mixed[-1], [5.0, 7.0])
    np.testing.assert_array_equal(own[:, 1], [2.0] * 6 + [0.5])


def test_residuals_that_hang_together_tell_less() -> None:
    rng = np.random.default_rng(1)
    residual = rng.standard_normal((4000, 7))
    residual[:, 1] = np.convolve(rng.standard_normal(4019), np.ones(20), "valid")
    own = (residual**2).mean(axis=0)
    loss = losses(1.01 * np.column_stack((own, own)), residual)
    assert loss.shape == (7, 2)
    assert loss[0, 0] == pytest.approx(4000 / 2.0 * np.log(1.01), rel=0.2)
    assert loss[1, 0] < 0.15 * loss[0, 0]


def test_a_joint_is_a_rival_by_itself_at_the_same_delay_and_all_are_at_another() -> None:
    vector = np.zeros(UNKNOWNS.size)
    vectors = np.ones((UNKNOWNS.size, 3))
    vectors[-1] = [0.0, 1.0, 1.0]
    loss = np.full((7, 3), 0.5 * TOLD_APART)
    loss[2, 0] = TOLD_APART
    loss[:, 2] = 0.1 * TOLD_APART
    rivals = likely(vector, vectors, loss)
    assert rivals.shape == (UNKNOWNS.size, 2)
    np.testing.assert_array_equal(rivals[:-1, 0].reshape(3, 7)[1], [1, 1, 0, 1, 1, 1, 1])
    np.testing.assert_array_equal(rivals[:, 1], vectors[:, 2])


def test_a_search_waits_for_the_last_joint_to_move() -> None:
    recording = light_robot()[1]
    q, v = motion().q.copy(), motion().v.copy()
    late = 600
    q[:late, 6], v[:late, 6] = q[0, 6], 0.0
    q[late:, 6] = q[0, 6] + 0.1
    commands = JointTrajectory(q, v, np.zeros_like(q))
    part = beginning(ServoRecording(commands, recording.times_s, recording.positions), 2.0)
    assert part.times_s[-1] == pytest.approx(late * 0.004 + 2.0, abs=0.03)
