"""How stiff a known hand is: laws, and a brute-force computation of what a force does to it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from skewmi.robot_models import yumi
from skewmi.robot_models.hand_stiffness import hand_stiffness
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.robot_models.yumi import Array

HOME = np.array(yumi.HOME["right"])
KP = CONTACT_SERVO.kp

scales = hnp.arrays(np.float64, 7, elements=st.floats(0.3, 2.0))
softer = hnp.arrays(np.float64, 7, elements=st.floats(0.3, 1.0))
configurations = hnp.arrays(np.float64, 7, elements=st.floats(-0.3, 0.3)).map(lambda d: HOME + d)


def displacement(kp: Array, q: Array, force: Array) -> Array:
    """Of a hand by a force, found by moving joints a little and looking where the hand goes."""
    kinematics, step = ArmKinematics("right"), 1e-6
    moved = (
        kinematics.forward(q + step * np.eye(7))[0] - kinematics.forward(q - step * np.eye(7))[0]
    )
    torque = moved @ force / (2 * step)
    at = kinematics.forward(np.array([q + 1e-5 * torque / kp, q - 1e-5 * torque / kp]))[0]
    moved_hand: Array = (at[0] - at[1]) / 2e-5
    return moved_hand


@settings(deadline=None, max_examples=25)
@given(softer, configurations, hnp.arrays(np.float64, 3, elements=st.floats(-30, 30)))
def test_a_softer_hand_that_a_force_moves_is_worth_what_it_moves_training_s(
    scale: Array, q: Array, force: Array
) -> None:
    moved, trained = (displacement(kp, q, force) for kp in (scale * KP, KP))
    found = hand_stiffness(scale * KP, q) @ moved
    np.testing.assert_allclose(found, trained, atol=1e-6 + 1e-4 * float(np.abs(moved).max()))


@settings(deadline=None, max_examples=25)
@given(scales, configurations, hnp.arrays(np.float64, 3, elements=st.floats(-1, 1)))
def test_no_hand_counts_as_stiffer_than_training_s(scale: Array, q: Array, error: Array) -> None:
    jacobian = ArmKinematics("right").jacobian(q)[:3]
    energy = np.linalg.inv((jacobian / KP) @ jacobian.T)
    felt = hand_stiffness(scale * KP, q) @ error
    assert felt @ energy @ felt <= (error @ energy @ error) * (1.0 + 1e-9)


@pytest.mark.parametrize("factor", [0.25, 1.0, 3.0])
def test_all_joints_alike_scale_all_directions(factor: float) -> None:
    expected = min(factor, 1.0) * np.eye(3)
    np.testing.assert_allclose(hand_stiffness(factor * KP, HOME), expected, atol=1e-12)
