"""Time-optimal stops of independent axes, in closed form.

An axis at velocity v and acceleration a is brought to rest (v = a = 0) as fast as the bounds
|acceleration| <= A and |jerk| <= J allow. With s = ±1 the sign of the braking acceleration, the
jerk is +sJ for t1, 0 for t2 and -sJ for t3. Writing v' = s v and a' = s a, s is chosen so that
letting the acceleration fade alone, which ends at v' + a'|a'| / 2J, would leave v' <= 0. Then

    peak acceleration  p = min(A, sqrt(J (-v') + a'^2 / 2))
    t1 = (p - a') / J,   t3 = p / J,   t2 = (-v' - (2 p^2 - a'^2) / 2J) / p

(the area under the trapezoid of acceleration equals -v'). Axes are not synchronised: each
stops in its own shortest time, which is what makes the stopping distance a bound that the
position guard can rely on.

All arrays have shape (m,) for m axes (joints in rad, or world axes in m), unless given.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stop:
    """A stop in four phases, the last of them rest; each array holds the phases' starts."""

    start_s: Array
    """Seconds from now. Shape (4, m)."""
    position: Array
    """Shape (4, m)."""
    velocity: Array
    """Zero in the last row. Shape (4, m)."""
    acceleration: Array
    """Zero in the last row. Shape (4, m)."""
    jerk: Array
    """During the phase; zero in the last row. Shape (4, m)."""

    @property
    def duration(self) -> float:
        """Seconds until the slowest axis is at rest."""
        return float(self.start_s[3].max())

    def sample(self, grid_dt: float) -> Array:
        """The stop on a time grid, first sample one grid step from now.

        Returns:
            Position, velocity, acceleration. Shape (3, n, m), n >= 1; in the last sample every
            axis is at rest exactly.
        """
        n = max(1, int(np.ceil(self.duration / grid_dt - 1e-9)))
        t = grid_dt * np.arange(1, n + 1)[:, None]
        phase = (t[..., None] >= self.start_s[1:].T - 1e-12).sum(axis=-1)
        phase[-1] = 3
        axis = np.arange(self.position.shape[1])
        s = t - self.start_s[phase, axis]
        q, v = self.position[phase, axis], self.velocity[phase, axis]
        a, j = self.acceleration[phase, axis], self.jerk[phase, axis]
        samples = np.empty((3, *s.shape))
        samples[0] = q + s * (v + s * (a / 2.0 + s * (j / 6.0)))
        samples[1] = v + s * (a + s * (j / 2.0))
        samples[2] = a + s * j
        return samples

    def extent(self) -> tuple[Array, Array]:
        """Lowest and highest position on the way, between grid points too.

        Returns:
            Low and high, each of shape (m,).
        """
        v0, a0, j0 = self.velocity[0], self.acceleration[0], self.jerk[0]
        # The velocity changes its sign at most once, in the first phase: where a strong
        # acceleration against a small velocity has to be undone.
        root = np.sqrt(np.maximum(a0 * a0 - 2.0 * j0 * v0, 0.0))
        turn = (-a0 - np.sign(j0) * root) / np.where(j0 == 0.0, 1.0, j0)
        turn = np.clip(turn, 0.0, self.start_s[1])
        turned = self.position[0] + turn * (v0 + turn * (a0 / 2.0 + turn * (j0 / 6.0)))
        corners = np.stack([self.position[0], turned, self.position[3]])
        return corners.min(axis=0), corners.max(axis=0)


def plan_stop(q: Array, v: Array, a: Array, acceleration: Array, jerk: Array) -> Stop:
    """The fastest stop from a state.

    Args:
        q: Present position.
        v: Present velocity.
        a: Present acceleration; |a| <= acceleration.
        acceleration: Bound, positive.
        jerk: Bound, positive.
    """
    faded = v + a * np.abs(a) / (2.0 * jerk)
    sign = np.where(faded > 0.0, -1.0, 1.0)
    v_s, a_s = sign * v, sign * a
    unbounded = np.sqrt(np.maximum(0.5 * a_s * a_s - jerk * v_s, 0.0))
    peak = np.maximum(np.minimum(acceleration, unbounded), a_s)
    plateau = (-v_s - (2.0 * peak * peak - a_s * a_s) / (2.0 * jerk)) / np.maximum(peak, 1e-12)
    # Below the bound there is no plateau; what the subtraction leaves there is rounding.
    plateau = np.where(unbounded > acceleration, np.maximum(plateau, 0.0), 0.0)
    m = q.size
    times = np.stack([np.maximum(peak - a_s, 0.0) / jerk, plateau, np.maximum(peak, 0.0) / jerk])
    jerks = np.zeros((4, m))
    jerks[0] = sign * jerk
    jerks[2] = -sign * jerk
    start = np.zeros((4, m))
    np.cumsum(times, axis=0, out=start[1:])
    qs, vs, accs = np.empty((4, m)), np.zeros((4, m)), np.zeros((4, m))
    qs[0], vs[0], accs[0] = q, v, a
    for i in range(3):
        t, j = times[i], jerks[i]
        qs[i + 1] = qs[i] + t * (vs[i] + t * (accs[i] / 2.0 + t * (j / 6.0)))
        vs[i + 1] = vs[i] + t * (accs[i] + t * (j / 2.0))
        accs[i + 1] = accs[i] + t * j
    # Zero up to rounding; exactly zero is what "at rest" means on the wire.
    vs[3] = 0.0
    accs[3] = 0.0
    return Stop(start, qs, vs, accs, jerks)


class ApproachSpeed:
    """Speed towards a bound from which a stop within a distance d is always possible.

    0.9 (-c + sqrt(c^2 + 2 A d)) with c = A^2 / 2J, zero for d <= 0. From velocity v and no
    acceleration a stop takes the distance v (v / A + A / J) / 2 (or less, where A is never
    reached), which equals d at v = -c + sqrt(c^2 + 2 A d); 0.9 leaves room for the acceleration
    present.

    Args:
        acceleration: Bound A, positive. Shape (m,).
        jerk: Bound J, positive. Shape (m,).
    """

    def __init__(self, acceleration: Array, jerk: Array) -> None:
        self._twice = 2.0 * acceleration
        self._c = acceleration * acceleration / (2.0 * jerk)
        self._square = self._c * self._c

    def __call__(self, distance: Array) -> Array:
        """For remaining distances to the bound less the margin. Shape (..., m)."""
        speed: Array = np.maximum(distance, 0.0)
        speed *= self._twice
        speed += self._square
        np.sqrt(speed, out=speed)
        speed -= self._c
        speed *= 0.9
        return speed


def approach_speed_of(distance: float, acceleration: float, jerk: float) -> float:
    """`ApproachSpeed` of one axis, in plain numbers."""
    if distance <= 0.0:
        return 0.0
    c = acceleration * acceleration / (2.0 * jerk)
    return 0.9 * (math.sqrt(c * c + 2.0 * acceleration * distance) - c)


def stop_extent_of(
    q: float, v: float, a: float, acceleration: float, jerk: float
) -> tuple[float, float]:
    """`plan_stop(...).extent()` of one axis, in plain numbers: lowest and highest position."""
    # Mirrored so that the braking acceleration is positive: v <= 0 or so.
    sign = -1.0 if v + a * abs(a) / (2.0 * jerk) > 0.0 else 1.0
    v, a = sign * v, sign * a
    unbounded = math.sqrt(max(0.5 * a * a - jerk * v, 0.0))
    peak = max(min(acceleration, unbounded), a)
    rise, fall = (peak - a) / jerk, max(peak, 0.0) / jerk
    plateau = 0.0
    if unbounded > acceleration:
        plateau = max((-v - (2.0 * peak * peak - a * a) / (2.0 * jerk)) / peak, 0.0)
    # Relative to q: where the velocity changes its sign while the acceleration rises, if it does.
    turn = 0.0
    discriminant = a * a - 2.0 * jerk * v
    if a < 0.0 and v > 0.0 and discriminant > 0.0:
        turn = min((-a - math.sqrt(discriminant)) / jerk, rise)
    turned = turn * (v + turn * (a / 2.0 + turn * (jerk / 6.0)))
    end = rise * (v + rise * (a / 2.0 + rise * (jerk / 6.0)))
    v += rise * (a + rise * (jerk / 2.0))
    end += plateau * (v + plateau * (peak / 2.0))
    v += plateau * peak
    end += fall * (v + fall * (peak / 2.0 - fall * (jerk / 6.0)))
    first, second = q + sign * turned, q + sign * end
    return min(q, first, second), max(q, first, second)
