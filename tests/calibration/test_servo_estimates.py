"""What counts as identified, and that whatever does not is named in a warning."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skewmi.calibration.servo_estimates import KNOWN_FRICTION, Estimate, estimates, is_known
from skewmi.calibration.servo_identification import ServoIdentification
from skewmi.calibration.servo_model import DelayedServo
from skewmi.calibration.servo_parameters import ServoUnknowns
from skewmi.calibration.servo_section import servo_warnings
from skewmi.calibration.stiction import Stiction
from skewmi.calibration.uncertainty import FitCovariance
from skewmi.robot_models import yumi
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.robot_models.yumi import Array

UNKNOWNS = ServoUnknowns(CONTACT_SERVO, free_armature=True, sticks=True)
JOINTS = yumi.joint_names("right")


def servo(stiction: Array) -> DelayedServo:
    """One whose joints have so much more friction at rest, N m. Shape (7,)."""
    angle = stiction / CONTACT_SERVO.kp
    return DelayedServo(CONTACT_SERVO, 0.013, Stiction(angle, np.full(7, 0.05)))


def found_with(stiction: Array, deviation: Array) -> dict[str, Estimate]:
    """Estimates of that servo from a fit with these standard deviations, in the vector's units."""
    covariance = np.diag(deviation**2)
    vector = UNKNOWNS.vector(servo(stiction))
    return estimates(UNKNOWNS, vector, FitCovariance(covariance, covariance), 0.0)


def identification(found: dict[str, Estimate], stiction: Array) -> ServoIdentification:
    return ServoIdentification(servo(stiction), found, np.full(7, 1e-4), np.ones(7), 0.02, 10.0)


def test_friction_at_rest_is_known_to_an_absolute_floor_as_other_friction_is() -> None:
    value, kp = np.array([0.0, 0.01, 0.09, 0.5, 0.0, 0.09, 0.5]), CONTACT_SERVO.kp
    half = np.array([0.019, 0.019, 0.019, 0.09, 0.021, 0.021, 0.11])
    expected = (True, True, True, True, False, False, False)
    for name in ("stiction", "frictionloss"):
        assert is_known(name, value, value - half, value + half, kp) == expected


def test_a_joint_that_hardly_sticks_needs_no_speed_at_which_that_has_gone() -> None:
    stiction = np.array([0.0, 0.5, 0.01, 0.5, 0.0, 0.5, 0.5])
    deviation = np.full(UNKNOWNS.size, 1e-6)
    # Nothing tells the first four joints' speeds.
    deviation[-8:-4] = 10.0
    found = found_with(stiction, deviation)
    assert stiction[2] < KNOWN_FRICTION
    assert all(found["stiction"].identified)
    assert found["stribeck_velocity"].identified == (True, False, True, False, True, True, True)
    told = [w for w in servo_warnings(identification(found, stiction)) if "not identified" in w]
    assert [w.split(" is ")[0] for w in told] == [
        f"stribeck_velocity of {JOINTS[joint]}" for joint in (1, 3)
    ]
    assert told[0].endswith(" rad/s")


@pytest.mark.parametrize("name", list(UNKNOWNS.derivatives(np.zeros(UNKNOWNS.size))))
def test_whatever_is_not_identified_is_named_in_a_warning(name: str) -> None:
    # Exit code 1 of `skewmi calibrate servo` says no more than that some flag is not set.
    stiction = np.full(7, 0.5)
    found = found_with(stiction, np.full(UNKNOWNS.size, 1e-6))
    assert all(all(estimate.identified) for estimate in found.values())
    flags = found[name].identified
    found[name] = replace(found[name], identified=(*flags[:-1], False))
    told = [w for w in servo_warnings(identification(found, stiction)) if "not identified" in w]
    assert len(told) == 1
    assert name in told[0]
    assert len(flags) == 1 or JOINTS[-1] in told[0]
