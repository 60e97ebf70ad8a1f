"""Which joint target is due when: the robot server's plan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skewmi.trajectory import GRID_NS, Array, JointPoint, JointTrajectory

REMEMBERED = 3
"""Samples before the present time that are kept: third differences reach so far back."""


class PlanExecutor:
    """The accepted plan in the robot server's time; at rest before its start and after its end.

    The plan is what accepted chunks, laid over one another, say: a chunk replaces all that would
    come from its stamp on, so that its braking tail replaces the older one. Since every chunk ends
    at rest, so does the plan, whatever happens to the commander.

    Its samples lie on the grid; it can be asked for any time, so that a robot's cycle may be any.

    Args:
        q: Where the arm rests now, rad. Shape (n_joints,).
        now_ns: The server's clock.
    """

    def __init__(self, q: Array, now_ns: int = 0) -> None:
        self.rest_at(q, now_ns)

    def rest_at(self, q: Array, now_ns: int) -> None:
        """Forget the plan, and what came before, and stay at `q`, shape (n_joints,), rad.

        Only for an arm that has been moved by somebody else: the command steps to where it is.
        """
        self._start_ns = now_ns - now_ns % GRID_NS
        self._samples = JointTrajectory.resting(q, 1)

    @property
    def end_ns(self) -> int:
        """When the plan's last sample is due, from which on the arm rests."""
        return self._start_ns + (len(self._samples) - 1) * GRID_NS

    def at_rest(self, time_ns: int) -> bool:
        """Whether the plan has been followed to its end at a time."""
        return time_ns >= self.end_ns

    def at(self, time_ns: int) -> JointPoint:
        """What is commanded at a time. The arrays must not be written to."""
        return self._samples.at(time_ns - self._start_ns)

    def before(self, time_ns: int) -> Array:
        """Positions at the `REMEMBERED` grid steps before a time, oldest first, rad.

        Args:
            time_ns: Not before the server's clock.

        Returns:
            Shape (REMEMBERED, n_joints).
        """
        return np.array([self.at(time_ns - age * GRID_NS).q for age in range(REMEMBERED, 0, -1)])

    def splice(self, stamp_ns: int, samples: JointTrajectory, now_ns: int) -> None:
        """Replace the plan from a time on; all but the last samples before now are forgotten.

        Args:
            stamp_ns: When the first sample is due, on the grid, at least `now_ns`.
            samples: From then on.
            now_ns: The server's clock.
        """
        assert stamp_ns >= now_ns
        assert stamp_ns % GRID_NS == 0
        first_ns = now_ns - now_ns % GRID_NS - REMEMBERED * GRID_NS
        begin, end = ((t - self._start_ns) // GRID_NS for t in (first_ns, stamp_ns))
        kept: slice | NDArray[np.intp] = slice(begin, end)
        if begin < 0 or end > len(self._samples):
            kept = np.clip(np.arange(begin, end), 0, len(self._samples) - 1)
        self._samples = JointTrajectory.concatenate(self._samples.part(kept), samples)
        self._start_ns = first_ns

    def end_at_rest(self, executed_ns: int) -> None:
        """Leave out what the plan does after the arm rests for the first time; without a rest
        before its end, that is nothing.

        An arm rests at a sample without velocity and acceleration that equals the two before it:
        staying there then adds a fourth, and no difference that the plan had not anyway. One equal
        sample is not enough. The motion might have just stopped, with more jerk than is allowed if
        it does not go on as was planned. What has been executed is remembered.

        Args:
            executed_ns: What is due up to this time has been executed.
        """
        q, v, a = self._samples.q, self._samples.v, self._samples.a
        moves = (q[1:] != q[:-1]).any(axis=1)
        rests = ~((v != 0.0) | (a != 0.0)).any(axis=1)
        rests[1:] &= ~moves
        rests[2:] &= ~moves[:-1]
        # Up to the next sample the motion towards it has begun.
        rests[: max(0, -((self._start_ns - executed_ns) // GRID_NS))] = False
        if rests.any():
            self._samples = self._samples.part(slice(0, int(rests.argmax()) + 1))
