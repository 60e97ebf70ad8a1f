"""The unknowns of servo identification as one vector.

Per joint: log(kp / nominal kp), log of kd / kp by its nominal value, and frictionloss / kp in
nominal units; then, if asked for, log(armature / nominal) per joint; last the delay. Ratios by kp,
because they are what a tracking error shows: e = (kd / kp) v + (frictionloss / kp) sign v at steady
speed. Logarithms, because stiffness and damping are positive.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np

from skewmi.calibration.servo_model import DelayedServo
from skewmi.calibration.stiction import Stiction
from skewmi.robot_models.servo import ServoParameters
from skewmi.robot_models.yumi import Array

WIDEST = log(6.0)
"""Stiffness, damping ratio and armature are sought within this factor of the nominal ones."""
LARGEST_FRICTION = 10.0
"""N m at the nominal stiffness: a softer servo's is sought up to less."""
LONGEST_DELAY_S = 0.15
DELAY_UNIT_S = 0.01
STRIBECK_VELOCITY = 0.05
"""rad/s"""
WIDEST_VELOCITY = log(10.0)
"""Stribeck velocities are sought within this factor of that."""
_LEAST_ANGLE = 1e-4


@dataclass(frozen=True, eq=False)
class ServoUnknowns:
    """Between vectors and servos.

    Attributes:
        nominal: Where the search begins and ends if nothing is known; its force limits, and its
            armature unless `free_armature`, are taken for known.
        free_armature: Whether the armature is an unknown, too.
        sticks: Whether friction at rest is one, too: more / kp in the friction's units, and
            log(Stribeck velocity / `STRIBECK_VELOCITY`), after the armature.
    """

    nominal: ServoParameters
    free_armature: bool = False
    sticks: bool = False

    @property
    def size(self) -> int:
        """Numbers of a vector."""
        return 22 + 7 * self.free_armature + 14 * self.sticks

    @property
    def friction_unit(self) -> Array:
        """Unit of frictionloss / kp, rad. Shape (7,)."""
        unit: Array = np.maximum(self.nominal.frictionloss / self.nominal.kp, _LEAST_ANGLE)
        return unit

    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest vector. Each shape (p,)."""
        wide = np.full(7, WIDEST)
        friction = LARGEST_FRICTION / self.nominal.kp / self.friction_unit
        high = [wide, wide, friction, *([wide] if self.free_armature else [])]
        low = [-wide, -wide, np.zeros(7), *([-wide] if self.free_armature else [])]
        if self.sticks:
            high += [friction, np.full(7, WIDEST_VELOCITY)]
            low += [np.zeros(7), np.full(7, -WIDEST_VELOCITY)]
        return (
            np.concatenate([*low, [0.0]]),
            np.concatenate([*high, [LONGEST_DELAY_S / DELAY_UNIT_S]]),
        )

    def vector(self, servo: DelayedServo) -> Array:
        """Of a servo, within the bounds. Shape (p,)."""
        own, nominal = servo.parameters, self.nominal
        lead, nominal_lead = own.kd / own.kp, nominal.kd / nominal.kp
        parts = [
            np.log(own.kp / nominal.kp),
            np.log(lead / nominal_lead),
            own.frictionloss / own.kp / self.friction_unit,
        ]
        if self.free_armature:
            parts.append(np.log(own.armature / nominal.armature))
        if self.sticks and servo.stiction is not None:
            more, speed = servo.stiction.angle, servo.stiction.velocity
            parts += [more / self.friction_unit, np.log(speed / STRIBECK_VELOCITY)]
        elif self.sticks:
            parts += [np.zeros(7), np.zeros(7)]
        low, high = self.bounds()
        within: Array = np.clip(np.concatenate([*parts, [servo.delay_s / DELAY_UNIT_S]]), low, high)
        return within

    def servo(self, vector: Array) -> DelayedServo:
        """Of a vector."""
        kp = self.nominal.kp * np.exp(vector[:7])
        changes = {
            "kp": kp,
            "kd": kp * self.nominal.kd / self.nominal.kp * np.exp(vector[7:14]),
            "frictionloss": kp * self.friction_unit * vector[14:21],
        }
        if self.free_armature:
            changes["armature"] = self.nominal.armature * np.exp(vector[21:28])
        parameters = self.nominal.with_changes(**changes)
        stiction = None
        if self.sticks:
            angle, speed = self.friction_unit * vector[-15:-8], np.exp(vector[-8:-1])
            stiction = Stiction(angle, STRIBECK_VELOCITY * speed)
        return DelayedServo(parameters, float(vector[-1]) * DELAY_UNIT_S, stiction)

    def derivatives(self, vector: Array) -> dict[str, Array]:
        """What intervals are given of, by the vector: logarithms of what is positive by nature,
        frictions in N m and rad, the delay in s. Each shape (7, p), the delay's (1, p)."""
        one = np.eye(self.size)
        kp, ratio, friction = one[:7], one[7:14], one[14:21]
        own = self.servo(vector).parameters
        angle = friction * self.friction_unit[:, None]
        found = {
            "kp": kp,
            "kd": kp + ratio,
            "kd_over_kp": ratio,
            "frictionloss": own.frictionloss[:, None] * kp + own.kp[:, None] * angle,
            "frictionloss_over_kp": angle,
            "delay": one[-1:] * DELAY_UNIT_S,
        }
        if self.free_armature:
            found["armature"] = one[21:28]
        if self.sticks:
            more, unit = vector[-15:-8, None], self.friction_unit[:, None]
            found["stiction"] = own.kp[:, None] * unit * (more * kp + one[-15:-8])
            found["stribeck_velocity"] = one[-8:-1]
        return found
