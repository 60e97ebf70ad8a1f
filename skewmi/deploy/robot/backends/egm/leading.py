"""References for a controller whose law and lag are known: ahead of the plan by as much.

A controller that obeys speed = low-pass(k (reference - desired) + speed reference) follows

    reference = q(t + L),   speed reference = v(t + L) + a(t + L) / w

without an error, L later, with w the corner of its low-pass. Of the future, q + L v and v + L a are
known. Positions keep the limit profile (`FeedForward`). Speeds are those of a flange that is no
faster than the robot admits, and of joints within the profile: what a dead bridge lets run on is
bounded by the speed that was sent last.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from skewmi.errors import ConfigurationError
from skewmi.robot_models.feed_forward import FeedForward
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import Array, JointPoint


class LeadingReferences:
    """What is sent in place of the plan, cycle by cycle.

    Args:
        positions: Runs ahead of the plan, within the limit profile.
        low_pass_s: Time constant 1 / w of the law's low-pass, s.
        admitted_speed: Of the flange, m/s.

    Raises:
        ConfigurationError: The feed-forward has no limits, or a number makes no sense.
    """

    def __init__(self, positions: FeedForward, low_pass_s: float, admitted_speed: float) -> None:
        if positions.limits is None:
            raise ConfigurationError("references of a controller must have limits")
        if not (0.0 <= low_pass_s < 10.0 and admitted_speed > 0.0):
            raise ConfigurationError(
                f"a low-pass of {low_pass_s} s and a flange speed of {admitted_speed} m/s; they "
                "must be in 0..10 s, and positive"
            )
        self._positions, self._admitted = positions, admitted_speed
        self._fastest = positions.limits.velocity
        self._ahead = positions.constants.lead + low_pass_s
        self._arm = ArmKinematics("right")

    def start(self, q: Array) -> None:
        """The arm rests at `q`, shape (7,), rad."""
        self._positions.start(q)

    def references(self, plan: JointPoint) -> tuple[Array, Array]:
        """For the next cycle.

        Args:
            plan: What is due.

        Returns:
            Position reference, rad, and speed reference, rad/s. Each shape (7,).
        """
        q = self._positions.step(plan.q, plan.v)
        wanted = np.clip(plan.v + self._ahead * plan.a, -self._fastest, self._fastest)
        return q, plan.v + self._part(plan, wanted - plan.v) * (wanted - plan.v)

    def _part(self, plan: JointPoint, more: Array) -> float:
        """How much of what is added to the plan's speed leaves the flange slow enough, 0..1."""
        if not more.any():
            return 1.0
        jacobian = self._arm.jacobian(plan.q)[:3]
        own, added = jacobian @ plan.v, jacobian @ more
        # |own + x added|^2 = admitted^2, for the larger x.
        square, cross = float(added @ added), float(own @ added)
        room = self._admitted**2 - float(own @ own)
        if room <= 0.0:
            return 0.0
        if square + 2.0 * cross <= room:
            return 1.0
        return min(1.0, (sqrt(cross**2 + square * room) - cross) / square)
