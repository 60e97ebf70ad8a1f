"""Fitted unknowns of an arm behind EGM as constants with 95 % intervals."""

from __future__ import annotations

import numpy as np

from skewmi.calibration.egm_parameters import EgmUnknowns
from skewmi.calibration.servo_estimates import KNOWN, KNOWN_DELAY_S, Estimate, is_known
from skewmi.calibration.uncertainty import TWO_SIDED_95, FitCovariance
from skewmi.robot_models.yumi import Array

_WIDEST = 20.0
_POSITIVE = ("kp", "kd", "kd_over_kp", "gain", "low_pass")
"""Of what intervals are of the logarithm."""
_POWERS = {
    "kp": -2.0,
    "kd": -1.0,
    "kd_over_kp": 1.0,
    "frictionloss": -2.0,
    "frictionloss_over_kp": 0.0,
    "delay": 1.0,
    "lag": 1.0,
    "gain": -1.0,
    "low_pass": -1.0,
}
"""Of the time that is in each constant: what it is multiplied by if time passes more slowly."""


def egm_estimates(
    unknowns: EgmUnknowns,
    vector: Array,
    covariance: FitCovariance,
    inertia_uncertainty: float,
    stretch: float,
) -> dict[str, Estimate]:
    """Every constant by name; see `EgmIdentification.estimates`.

    Args:
        unknowns: What the vector means.
        vector: That fits best, in cycles of 4 ms. Shape (24,).
        covariance: Of the vector.
        inertia_uncertainty: Standard deviation of the joints' inertia, as a part of it.
        stretch: How long a cycle takes, by 4 ms.
    """
    arm, lags = unknowns.arm(vector), unknowns.lags(vector)
    own = arm.servo.parameters
    values = {
        "kp": own.kp,
        "kd": own.kd,
        "kd_over_kp": own.kd / own.kp,
        "frictionloss": own.frictionloss,
        "frictionloss_over_kp": own.frictionloss / own.kp,
        "delay": np.array([arm.servo.delay_s]),
        "lag": lags,
        "gain": np.array([arm.law.gain]),
        "low_pass": np.array([arm.law.low_pass_hz]),
    }
    found = {}
    for name, derivative in unknowns.derivatives(vector).items():
        value, deviation = values[name], covariance.deviations(derivative)
        if name in ("kp", "kd"):
            deviation = np.hypot(deviation, inertia_uncertainty)
        elif name == "frictionloss":
            deviation = np.hypot(deviation, inertia_uncertainty * value)
        half = TWO_SIDED_95 * deviation
        if name in _POSITIVE:
            half = np.minimum(half, _WIDEST)
            low, high = value * np.exp(-half), value * np.exp(half)
        else:
            least = -np.inf if name == "lag" else 0.0
            low, high = np.maximum(value - half, least), value + half
        known = _is_known(name, value, low, high, own.kp)
        factor = stretch ** _POWERS[name]
        found[name] = Estimate(factor * value, factor * low, factor * high, known)
    return found


def _is_known(name: str, value: Array, low: Array, high: Array, kp: Array) -> tuple[bool, ...]:
    if name == "lag":
        allowed = np.maximum(KNOWN * np.abs(value), KNOWN_DELAY_S)
        return tuple(bool(known) for known in (high - low) / 2.0 <= allowed)
    return is_known(name, value, low, high, kp)
