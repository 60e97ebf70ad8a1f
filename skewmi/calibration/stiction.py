"""Friction that is larger at rest than in motion.

F(v) = F_c + F_m exp(-(v / v_s)^2): F_c in motion, F_c + F_m at rest, v_s the Stribeck velocity
(Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994, section 2.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skewmi.robot_models.yumi import Array


@dataclass(frozen=True, eq=False)
class Stiction:
    """What seven joints have more of at rest.

    Attributes:
        angle: F_m / kp, rad: by so much more a joint at rest is held off its target. Shape (7,),
            or (n, 7) for n arms.
        velocity: v_s, rad/s. Of the same shape.
    """

    angle: Array
    velocity: Array

    def left(self, v: Array) -> Array:
        """What there is of `angle` at a speed, rad/s, shape (..., 7); rad."""
        left: Array = self.angle * np.exp(-np.square(v / self.velocity))
        return left
