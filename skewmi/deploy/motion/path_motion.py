"""A motion that is known beforehand, as chunks; every stop stays on its path.

Chunk k brings the five samples from sample 5k on and then stops: the motion is followed further at
a falling pace. With s the motion's own time, q(t) = m(s(t)) and

    ds/dt = (1 + cos(pi t / T)) / 2      from 1 to 0 within T

so that the arm, stopped at any time, is nowhere but on the path that was looked at beforehand, and
its flange is slower than on the way. The acceleration m'' (ds/dt)^2 + m' d2s/dt2 and the jerk

    m''' (ds/dt)^3 + 3 m'' ds/dt d2s/dt2 + m' d3s/dt3

can be larger than the motion's own: T is, for each chunk, the shortest of a ladder of times at
which no limit is broken. All stops are worked out before the arm moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np
from numpy.typing import NDArray

from skewmi.errors import ConfigurationError, LimitViolationError
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import CYCLE_TICKS, GRID_S, Array, JointTrajectory

LONGEST_STOP_S = 1.9
"""A chunk may have 500 points, 2 s, and its own five samples are part of it. Some excitations
within `careful` need more than 1.6 s."""
SHORTEST_STOP_S = 0.04
_LADDER = 1.2
"""Ratio of one stop's time to the next shorter one that is tried."""
HEADROOM = 0.98
"""Part of each limit that stops use."""
_AT_ONCE = 256
"""Chunks that are worked out together: bounds the memory."""


class PathMotion:
    """A motion from rest to rest whose stops stay on its path.

    Args:
        trajectory: Begins and ends at rest; within the limits.
        limits: That stops keep, too.

    Attributes:
        trajectory: As given.
        longest_stop_s: Time of the slowest stop, s.

    Raises:
        ConfigurationError: It does not begin and end at rest.
        LimitViolationError: Somewhere no stop within `LONGEST_STOP_S` keeps the limits.
    """

    def __init__(self, trajectory: JointTrajectory, limits: JointLimits) -> None:
        for name, row in (("begins", 0), ("ends", -1)):
            if trajectory.v[row].any() or trajectory.a[row].any():
                raise ConfigurationError(f"the motion {name} with a velocity; it must be at rest")
        self.trajectory = trajectory
        self._path = _Path(trajectory)
        self._limits = limits
        self._stop_ticks = self._work_out()
        self.longest_stop_s = float(self._stop_ticks.max()) * GRID_S

    @property
    def cycles(self) -> int:
        """How many chunks there are, at least one."""
        return max(1, -(-(len(self.trajectory) - 1) // CYCLE_TICKS))

    def chunk(self, cycle: int) -> JointTrajectory:
        """The chunk that starts `cycle` cycles after the beginning, with its stop.

        Raises:
            ConfigurationError: `cycle` is negative. (After the last cycle the arm rests.)
        """
        if cycle < 0:
            raise ConfigurationError(f"cycle is {cycle}; it must not be negative")
        first, last = cycle * CYCLE_TICKS, len(self.trajectory) - 1
        rows = np.minimum(np.arange(first, first + CYCLE_TICKS + 1), last)
        head = self.trajectory.part(rows)
        if rows[-1] == last:
            return head
        q, v, a, _ = (part[0, 1:] for part in self._stops(rows[-1:], self._stop_ticks[cycle]))
        v[-1] = a[-1] = 0.0
        return JointTrajectory.concatenate(head, JointTrajectory(q, v, a))

    def _work_out(self) -> NDArray[np.int64]:
        """Ticks of each cycle's stop. Shape (cycles,)."""
        splices = (np.arange(self.cycles) + 1) * CYCLE_TICKS
        ticks = np.zeros(self.cycles, dtype=np.int64)
        # The last chunk ends where the motion does.
        undone = np.flatnonzero(splices < len(self.trajectory) - 1)
        stop_s = SHORTEST_STOP_S
        while undone.size and stop_s <= LONGEST_STOP_S:
            n = round(stop_s / GRID_S)
            for part in np.array_split(undone, -(-undone.size // _AT_ONCE)):
                stops = self._stops(splices[part], n)
                fits = np.flatnonzero(self._use(stops) <= HEADROOM)
                # Dear, so for those alone that need no more time for another reason.
                smooth = self._use_between(splices[part[fits]], [x[fits] for x in stops])
                ticks[part[fits[smooth <= HEADROOM]]] = n
            undone = undone[ticks[undone] == 0]
            stop_s *= _LADDER
        if undone.size:
            stops = self._stops(splices[undone[:1]], n)
            use = max(self._use(stops)[0], self._use_between(splices[undone[:1]], stops)[0])
            raise LimitViolationError(
                f"acceleration or jerk of a stop within {LONGEST_STOP_S:g} s, as part of its limit",
                float(use),
                HEADROOM,
                f"at {splices[undone[0]] * GRID_S:.2f} s of the motion",
            )
        return ticks

    def _use(self, stops: Sequence[Array]) -> Array:
        """Largest part of a limit that the derivatives at the samples use. Shape (k,)."""
        limits = self._limits
        bounds = (limits.velocity, limits.acceleration, limits.jerk)
        parts = zip(stops[1:], bounds, strict=True)
        use: Array = np.max([(np.abs(x) / bound).max(axis=(1, 2)) for x, bound in parts], axis=0)
        return use

    def _use_between(self, rows: NDArray[np.int64], stops: Sequence[Array]) -> Array:
        """Largest part that the differences use, from the motion before to the rest after.

        Between samples a motion may be rougher than at them: robot servers look at both.

        Args:
            rows: Samples that the stops begin from. Shape (k,).
            stops: See `_stops`.

        Returns:
            Shape (k,).
        """
        limits, h = self._limits, GRID_S
        q, v, a, _ = stops
        before = self.trajectory.q[rows[:, None] + np.array([-2, -1])]
        after = np.repeat(q[:, -1:], 3, axis=1)
        steps = [np.diff(np.concatenate((before, q, after), axis=1), k, axis=1) for k in (1, 2, 3)]
        v0, v1, a0, a1 = v[:, :-1], v[:, 1:], a[:, :-1], a[:, 1:]
        dq, dv = np.diff(q, axis=1), v1 - v0
        parts = (
            (limits.velocity, steps[0] / h),
            *((limits.acceleration, x) for x in (dv / h, steps[1] / h**2)),
            *((limits.jerk, x) for x in ((a1 - a0) / h, np.diff(dv, axis=1) / h**2)),
            (limits.jerk, steps[2] / h**3),
            # What is left of a step when the derivatives at one of its ends have explained theirs.
            *((limits.jerk, 2.0 * (dv - x * h) / h**2) for x in (a0, a1)),
            (limits.jerk, 6.0 * (dq - v0 * h - a0 * h * h / 2.0) / h**3),
            (limits.jerk, 6.0 * (dq - v1 * h + a1 * h * h / 2.0) / h**3),
        )
        use: Array = np.max([(np.abs(x) / bound).max(axis=(1, 2)) for bound, x in parts], axis=0)
        return use

    def _stops(self, rows: NDArray[np.int64], n: int) -> tuple[Array, Array, Array, Array]:
        """Stops of n ticks from samples of the motion: q, v, a, jerk, each shape (k, n + 1, 7).

        The jerk of the first row is that just after it: the stop begins with a step of it.
        """
        total = n * GRID_S
        t = np.arange(n + 1) * GRID_S
        angle = pi * t / total
        pace = ((1.0 + np.cos(angle)) / 2.0)[:, None]
        slowing = (-pi / (2.0 * total) * np.sin(angle))[:, None]
        sudden = (-(pi**2) / (2.0 * total**2) * np.cos(angle))[:, None]
        way = t / 2.0 + total / (2.0 * pi) * np.sin(angle)
        q, first, second, third = self._path.at(rows[:, None] * GRID_S + way)
        return (
            q,
            first * pace,
            second * pace**2 + first * slowing,
            third * pace**3 + 3.0 * second * pace * slowing + first * sudden,
        )


class _Path:
    """A trajectory between its samples: polynomials of degree five through each two neighbours,
    as `JointTrajectory.at`; after its end it rests."""

    def __init__(self, trajectory: JointTrajectory) -> None:
        h = GRID_S
        q, v, a = trajectory.q, trajectory.v, trajectory.a
        dq = q[1:] - (q[:-1] + h * (v[:-1] + 0.5 * h * a[:-1]))
        dv = h * (v[1:] - (v[:-1] + h * a[:-1]))
        da = h * h * (a[1:] - a[:-1])
        self._coefficients = np.stack(
            [
                q[:-1],
                h * v[:-1],
                0.5 * h * h * a[:-1],
                10.0 * dq - 4.0 * dv + 0.5 * da,
                -15.0 * dq + 7.0 * dv - da,
                6.0 * dq - 3.0 * dv + 0.5 * da,
            ]
        )
        """Of (t / h)^k. Shape (6, n - 1, 7)."""

    def at(self, time_s: Array) -> tuple[Array, Array, Array, Array]:
        """Position and three derivatives by the motion's time. Each shape (*time_s.shape, 7)."""
        last = self._coefficients.shape[1] - 1
        place = np.minimum(time_s / GRID_S, last + 1.0)
        index = np.minimum(np.floor(place + 1e-9).astype(np.int64), last)
        u = (place - index)[..., None]
        c0, c1, c2, c3, c4, c5 = self._coefficients[:, index]
        q = c0 + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5))))
        v = c1 + u * (2.0 * c2 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)))
        a = 2.0 * c2 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5))
        j = 6.0 * c3 + u * (24.0 * c4 + u * 60.0 * c5)
        return q, v / GRID_S, a / GRID_S**2, j / GRID_S**3
