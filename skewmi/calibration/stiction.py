"""Friction that is larger at rest than in motion, in a simulation whose friction is constant.

F(v) = F_c + F_m exp(-(v / v_s)^2): F_c in motion, F_c + F_m at rest, v_s the Stribeck velocity
(Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994, section 2.2). A rollout cannot
change friction on its way. So a joint is given the friction that it has at rest, and its target is
moved ahead by what it lacks in motion, which a first rollout tells: a servo pushes by kp times the
distance to its target, and F_m / kp is an angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skewmi.robot_models.servo import ServoParameters
from skewmi.robot_models.yumi import Array


@dataclass(frozen=True, eq=False)
class Stiction:
    """What seven joints have more of at rest.

    Attributes:
        angle: F_m / kp, rad. Shape (7,).
        velocity: v_s, rad/s. Shape (7,).
    """

    angle: Array
    velocity: Array

    def at_rest(self, parameters: ServoParameters) -> ServoParameters:
        """Servos whose joints have the friction of rest, of those with that of motion."""
        more = parameters.kp * self.angle
        return parameters.with_changes(frictionloss=parameters.frictionloss + more)

    def left(self, v: Array) -> Array:
        """What there is in motion of what there is more at rest, by kp. (..., 7) -> rad."""
        left: Array = self.angle * np.exp(-np.square(v / self.velocity))
        return left

    def relief(self, v: Array) -> Array:
        """How far ahead targets of `at_rest` are in motion. rad/s, (n, 7) -> rad, (n, 7)."""
        gone: Array = -np.expm1(-np.square(v / self.velocity))
        return np.sign(v) * self.angle * gone
