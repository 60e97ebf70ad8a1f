"""Joint motion as every part says it: samples of position, velocity, acceleration every 4 ms.

The planner makes a `JointTrajectory`, the checks judge it, the link carries it with names and a
stamp (`TrajectoryChunk`), and the robot server samples it at the times of its robot's own cycle.

Imports numpy and the errors alone, so that everybody may import it. `deploy.safety.limits` does
not take the grid from here: it restates what it judges by.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skewmi.errors import ConfigurationError

Array = NDArray[np.float64]

GRID_NS = 4_000_000
"""Time between two samples, ns: the nominal cycle of ABB's externally guided motion."""
CYCLE_NS = 20_000_000
"""Time between two chunks of the planner, and between two published robot states, ns."""
CYCLE_TICKS = CYCLE_NS // GRID_NS
GRID_S = GRID_NS / 1e9
CYCLE_S = CYCLE_NS / 1e9


class JointPoint(NamedTuple):
    """Joint state at one time. Each of shape (d,); rad, rad/s, rad/s^2."""

    q: Array
    v: Array
    a: Array


@dataclass(frozen=True, slots=True, eq=False)
class JointTrajectory:
    """Samples of one motion, `GRID_NS` apart. The arrays must not be written to.

    Between two samples the motion is the polynomial of degree five through both, which has their
    positions, velocities and accelerations; before the first and after the last sample it stays
    at that sample. (What is sent ends at rest.)

    Attributes:
        q: Positions, rad. Shape (n, d).
        v: Velocities, rad/s. Shape (n, d).
        a: Accelerations, rad/s^2. Shape (n, d).

    Raises:
        ConfigurationError: The shapes differ, or are not of two dimensions.
    """

    q: Array
    v: Array
    a: Array

    def __post_init__(self) -> None:
        if not (self.q.ndim == 2 and self.q.shape == self.v.shape == self.a.shape):
            raise ConfigurationError(
                f"a trajectory has q {self.q.shape}, v {self.v.shape}, a {self.a.shape}; "
                "all three must have the same shape (samples, joints)"
            )

    @staticmethod
    def resting(q: Array, samples: int) -> JointTrajectory:
        """Standing still.

        Args:
            q: Where, rad. Shape (d,).
            samples: How many.
        """
        rows = np.tile(np.asarray(q, dtype=np.float64), (samples, 1))
        return JointTrajectory(rows, np.zeros_like(rows), np.zeros_like(rows))

    @staticmethod
    def concatenate(first: JointTrajectory, second: JointTrajectory) -> JointTrajectory:
        """One motion after the other: the second's first sample is one grid step later."""
        return JointTrajectory(
            np.concatenate((first.q, second.q)),
            np.concatenate((first.v, second.v)),
            np.concatenate((first.a, second.a)),
        )

    def __len__(self) -> int:
        return len(self.q)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample, s."""
        return (len(self.q) - 1) * GRID_S

    @property
    def times_ns(self) -> NDArray[np.int64]:
        """Times of the samples after the first, ns. Shape (n,)."""
        return np.arange(len(self.q), dtype=np.int64) * GRID_NS

    @property
    def rest_ns(self) -> int:
        """Time from the first sample to the first that all later ones equal, at rest, ns."""
        moves = (self.v != 0.0) | (self.a != 0.0) | (self.q != self.q[-1])
        rows = np.flatnonzero(moves.any(axis=1))
        return (int(rows[-1]) + 1 if rows.size else 0) * GRID_NS

    def point(self, index: int) -> JointPoint:
        """The sample of that index, the nearest one if there is none. There must be samples."""
        index = min(max(index, 0), len(self.q) - 1)
        return JointPoint(self.q[index], self.v[index], self.a[index])

    def at(self, time_ns: int) -> JointPoint:
        """The motion at a time after the first sample, ns. There must be samples."""
        index, off_ns = divmod(time_ns, GRID_NS)
        if off_ns == 0 or index < 0 or index >= len(self.q) - 1:
            return self.point(index)
        return _between(self.point(index), self.point(index + 1), off_ns / GRID_NS)

    def part(self, rows: slice | NDArray[np.intp]) -> JointTrajectory:
        """Some of the samples, as if they followed one another."""
        return JointTrajectory(self.q[rows], self.v[rows], self.a[rows])

    def rest_of(self, index: int, at_least: int) -> JointTrajectory:
        """From a sample on, the last one repeated until there are `at_least`."""
        last = len(self.q) - 1
        return self.part(np.minimum(np.arange(index, max(last + 1, index + at_least)), last))


@dataclass(frozen=True)
class TrajectoryChunk:
    """A trajectory as it travels: whose, when it is due, and what the sender says of its grid."""

    stamp_ns: int
    """Robot server clock at which the first sample is due, ns."""
    joint_names: tuple[str, ...]
    """Names of the d joints, chain order."""
    time_from_start_ns: NDArray[np.int64]
    """When each sample is due after the stamp, ns; a stranger may say anything. Shape (n,)."""
    trajectory: JointTrajectory
    """The n samples."""

    @staticmethod
    def of(
        stamp_ns: int, joint_names: tuple[str, ...], trajectory: JointTrajectory
    ) -> TrajectoryChunk:
        """A trajectory on its own grid."""
        return TrajectoryChunk(stamp_ns, joint_names, trajectory.times_ns, trajectory)


def _between(first: JointPoint, second: JointPoint, fraction: float) -> JointPoint:
    """The polynomial of degree five through two neighbouring samples, part of the way from the
    first to the second.

    With u the fraction, h the grid step and dq, dv, da what the second sample differs by from the
    first one continued at constant acceleration,

        q(u) = q0 + v0 h u + a0 h^2 u^2 / 2 + c3 u^3 + c4 u^4 + c5 u^5
        c3 = 10 dq - 4 h dv + h^2 da / 2,  c4 = -15 dq + 7 h dv - h^2 da,
        c5 = 6 dq - 3 h dv + h^2 da / 2

    which is exact for constant jerk (c4 = c5 = 0).
    """
    (q, v, a), h, u = first, GRID_S, fraction
    dq = second.q - (q + h * (v + (0.5 * h) * a))
    dv = h * (second.v - (v + h * a))
    da = (h * h) * (second.a - a)
    c3 = 10.0 * dq - 4.0 * dv + 0.5 * da
    c4 = -15.0 * dq + 7.0 * dv - da
    c5 = 6.0 * dq - 3.0 * dv + 0.5 * da
    s = u * h
    return JointPoint(
        q + s * (v + (0.5 * s) * a) + (u * u * u) * (c3 + u * (c4 + u * c5)),
        v + s * a + (u * u / h) * (3.0 * c3 + u * (4.0 * c4 + u * (5.0 * c5))),
        a + (u / (h * h)) * (6.0 * c3 + u * (12.0 * c4 + u * (20.0 * c5))),
    )
