"""How fast the hand may move outwards where it is beyond a face of its box, in the tolerance.

Inside the box the shaped command sees to it. But the hand lags behind it and swings by some
millimetres where joints are at their bounds, and the joints may have other things to put right
than its position: then the program for the joints has to know the face itself.
"""

from __future__ import annotations

import numpy as np

from skewmi.deploy.motion.brake import ApproachSpeed, Array
from skewmi.deploy.motion.hand_bounds import HandBounds

WATCHED_FROM = 0.4
"""Part of the tolerance beyond which a face is watched; hands that stop at one go less far."""

KEPT_TO = 0.95
"""Part of the tolerance to which the hand may come: a straight joint motion bends the hand's."""

WAY_BACK = 5.0
"""Speed of the way back per distance beyond that, 1/s."""


class Faces:
    """The faces of a box.

    Args:
        low: World, m. Shape (3,).
        high: Likewise.
        tolerance: How far the hand may be outside, m.
        bounds: With which acceleration and jerk it stops.
    """

    def __init__(self, low: Array, high: Array, tolerance: float, bounds: HandBounds) -> None:
        self._low, self._high = low, high
        self._watched = WATCHED_FROM * tolerance
        # Plain numbers: this is asked every grid step, and nearly always there is no face near.
        self._unwatched = list(
            zip(
                (low - self._watched).tolist(),
                (high + self._watched).tolist(),
                strict=True,
            )
        )
        self._kept = KEPT_TO * tolerance
        ones = np.ones(6)
        self._approach = ApproachSpeed(bounds.acceleration * ones, bounds.jerk * ones)

    def outwards(self, position: Array) -> Array | None:
        """Highest velocities outwards, m/s.

        Args:
            position: Of the hand, world, m. Shape (3,).

        Returns:
            In the directions -x, -y, -z, x, y, z, infinite where a face is not near and negative
            where the hand is too far beyond; None if no face is near. Shape (6,).
        """
        inside = zip(position.tolist(), self._unwatched, strict=True)
        if all(low <= x <= high for x, (low, high) in inside):
            return None
        beyond = np.concatenate((self._low - position, position - self._high))
        room = self._kept - beyond
        speed = np.where(room >= 0.0, self._approach(room), WAY_BACK * room)
        outwards: Array = np.where(beyond > self._watched, speed, np.inf)
        return outwards
