"""The commanded position, smoothed: a policy's commands turn corners ten times a second.

A shaper that turns each corner as fast as its limits allow has much of its acceleration above
10 Hz, where arms and their mounts resonate. So the command goes through a filter of finite length
first, a Hann window: above 2 / length nearly nothing of a corner is left, a straight line stays
straight, a rest is a rest after that length, and nothing overshoots or leaves a convex box, as all
weights are positive. The price is a delay of half the length.
"""

from __future__ import annotations

import numpy as np

from skewmi.deploy.motion.brake import Array
from skewmi.deploy.motion.cartesian_shaper import Reference
from skewmi.trajectory import GRID_S

WINDOW_S = 0.120
"""Length of the filter, s."""

DELAY_S = WINDOW_S / 2.0
"""By how much the smoothed command is behind, s."""

FORESEEN = 0.95
"""Part of that delay for which whoever follows need not be later still. A shaper that turns in the
same time as the window turns a little later than it, and overshoots a stop: the more, the larger
this is. Each 0.05 less is 2 ms more of lag."""


class SmoothedReference:
    """A reference's weighted mean over the last `WINDOW_S`.

    Args:
        position_w: Where the reference has rested, world, m. Shape (3,).

    Attributes:
        position_w: Smoothed, world, m. Shape (3,).
        velocity_w: Its velocity, m/s. Shape (3,).
    """

    def __init__(self, position_w: Array) -> None:
        count = round(WINDOW_S / GRID_S)
        weights = np.hanning(count + 2)[1:-1]
        # Twice, so that the window over a ring of samples is a slice.
        self._weights = np.tile(weights / weights.sum(), 2)
        self._samples = np.zeros((count, 6))
        self._next = 0
        self.rest(position_w)

    def rest(self, position_w: Array) -> None:
        """Forget what was: the reference rests here."""
        self._samples[:, :3] = position_w
        self._samples[:, 3:] = 0.0
        self.position_w = np.array(position_w, dtype=np.float64)
        self.velocity_w = np.zeros(3)

    def follow(self, reference: Reference) -> None:
        """Take in the reference of the next grid step."""
        count = len(self._samples)
        newest = self._samples[self._next]
        newest[:3], newest[3:] = reference.position_w, reference.velocity_w
        self._next = (self._next + 1) % count
        # The oldest sample lies where the next one will; the window is symmetric.
        mean = self._weights[count - self._next : 2 * count - self._next] @ self._samples
        self.position_w, self.velocity_w = mean[:3], mean[3:]
