"""Which joint target is due at which tick: the robot server's plan on its own 4 ms grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skewmi.trajectory import Array, JointPoint, JointTrajectory

REMEMBERED = 3
"""Samples before the one that is due next that are kept: third differences reach so far back."""


class PlanExecutor:
    """Samples of the accepted plan by tick; at rest before its first and after its last sample.

    The plan is what accepted chunks, laid over one another, say: a chunk replaces every sample
    from its first tick on, so that its braking tail replaces the older one. Since every chunk
    ends at rest, so does the plan, whatever happens to the commander.

    Args:
        q: Where the arm rests now, rad. Shape (n_joints,).
        tick: The tick that is due next.
    """

    def __init__(self, q: Array, tick: int = 0) -> None:
        self.rest_at(q, tick)

    def rest_at(self, q: Array, tick: int) -> None:
        """Forget the plan and stay at `q`, shape (n_joints,), rad."""
        self._first_tick = tick
        self._samples = JointTrajectory.resting(q, 1)

    @property
    def last_tick(self) -> int:
        """The tick of the plan's last sample, from which on the arm rests."""
        return self._first_tick + len(self._samples) - 1

    def at_rest(self, tick: int) -> bool:
        """Whether the plan has been followed to its end at `tick`."""
        return tick >= self.last_tick

    def point(self, tick: int) -> JointPoint:
        """What is commanded at `tick`. The arrays must not be written to."""
        return self._samples.point(tick - self._first_tick)

    def before(self, tick: int) -> Array:
        """Positions at the `REMEMBERED` ticks before `tick`, oldest first, rad.

        Args:
            tick: Not before the one that is due next.

        Returns:
            Shape (REMEMBERED, n_joints).
        """
        return np.array([self.point(tick - age).q for age in range(REMEMBERED, 0, -1)])

    def splice(self, tick: int, samples: JointTrajectory, now: int) -> None:
        """Replace the plan from `tick` on; all but the last samples before `now` are forgotten.

        Args:
            tick: When the first sample is due, at least `now`.
            samples: From then on.
            now: The tick that is due next.
        """
        assert tick >= now
        first = now - REMEMBERED
        begin, end = first - self._first_tick, tick - self._first_tick
        kept: slice | NDArray[np.intp] = slice(begin, end)
        if begin < 0 or end > len(self._samples):
            kept = np.clip(np.arange(begin, end), 0, len(self._samples) - 1)
        self._samples = JointTrajectory.concatenate(self._samples.part(kept), samples)
        self._first_tick = first
