"""Fitted unknowns as constants with 95 % intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skewmi.calibration.servo_parameters import ServoUnknowns
from skewmi.calibration.uncertainty import TWO_SIDED_95, FitCovariance
from skewmi.robot_models.yumi import Array

KNOWN = 0.2
"""Largest half-width, as a part of the value, of a constant that counts as identified."""
KNOWN_FRICTION = 0.02
"""The same for friction, and for what it is more at rest, N m, if that is more."""
KNOWN_DELAY_S = 0.002
"""The same for the delay, s, if that is more."""
_WIDEST = 20.0
"""Half-width of a logarithm; beyond it a value is not known anyway."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Values with their 95 % intervals. Each shape (7,), of the delay (1,)."""

    value: Array
    low: Array
    high: Array
    identified: tuple[bool, ...]
    """Whether the interval is narrow enough to say that the value is known."""


def estimates(
    unknowns: ServoUnknowns, vector: Array, covariance: FitCovariance, inertia_uncertainty: float
) -> dict[str, Estimate]:
    """Every constant and ratio, by name; see `ServoIdentification.estimates`.

    Args:
        unknowns: What the vector means.
        vector: That fits best. Shape (p,).
        covariance: Of the vector.
        inertia_uncertainty: Standard deviation of the joints' inertia, as a part of it. Positions
            tell stiffness, damping and friction per inertia alone.
    """
    servo = unknowns.servo(vector)
    own = servo.parameters
    values = {
        "kp": own.kp,
        "kd": own.kd,
        "kd_over_kp": own.kd / own.kp,
        "frictionloss": own.frictionloss,
        "frictionloss_over_kp": own.frictionloss / own.kp,
        "delay": np.array([servo.delay_s]),
        "armature": own.armature,
    }
    if servo.stiction is not None:
        values["stiction"] = own.kp * servo.stiction.angle
        values["stribeck_velocity"] = servo.stiction.velocity
    found = {}
    for name, derivative in unknowns.derivatives(vector).items():
        value = values[name]
        deviation = covariance.deviations(derivative)
        if name in ("kp", "kd", "armature"):
            deviation = np.hypot(deviation, inertia_uncertainty)
        elif name in ("frictionloss", "stiction"):
            deviation = np.hypot(deviation, inertia_uncertainty * value)
        half = TWO_SIDED_95 * deviation
        if name.startswith(("friction", "delay", "stiction")):
            low, high = np.maximum(value - half, 0.0), value + half
        else:
            half = np.minimum(half, _WIDEST)
            low, high = value * np.exp(-half), value * np.exp(half)
        known = is_known(name, value, low, high, own.kp)
        if name == "stribeck_velocity":
            # The speed at which next to nothing has gone cannot be known, and does not matter.
            known = tuple(np.logical_or(known, ~sticks(values["stiction"])).tolist())
        found[name] = Estimate(value, low, high, known)
    return found


def sticks(stiction: Array) -> NDArray[np.bool_]:
    """Whether joints have more friction at rest than can be told from none.

    Args:
        stiction: What they have more at rest, N m. Shape (7,).
    """
    found: NDArray[np.bool_] = stiction >= KNOWN_FRICTION
    return found


def is_known(name: str, value: Array, low: Array, high: Array, kp: Array) -> tuple[bool, ...]:
    """Whether the interval of a constant is narrow enough to say so.

    Args:
        name: Of the constant.
        value, low, high: Of it.
        kp: Stiffness of the same joints, N m/rad. Shape (7,).
    """
    allowed = KNOWN * value
    if name in ("frictionloss", "stiction"):
        allowed = np.maximum(allowed, KNOWN_FRICTION)
    elif name == "frictionloss_over_kp":
        allowed = np.maximum(allowed, KNOWN_FRICTION / kp)
    elif name == "delay":
        allowed = np.maximum(allowed, KNOWN_DELAY_S)
    return tuple(bool(known) for known in (high - low) / 2.0 <= allowed)
