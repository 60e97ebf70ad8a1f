"""Positions within their bounds for whatever is sent tick by tick: room to stop is always kept.

With the grid's own units (rad, rad/tick, rad/tick^2, rad/tick^3) what is sent moves by

    v' = v + a',   x' = x + v',   |a' - a| <= j

Braking towards a bound above takes j off the acceleration each tick until it is -b, and keeps that:
a_i = max(a - i j, -b), also for an a below -b. Its highest position, x + peak(v, a), has

    peak(v, a) = max(0, max over n of  n v + n a_1 + (n - 1) a_2 + ... + a_n)

The guard lets an acceleration through if x' + peak(v', a') <= bound. That is enough for ever: the
next tick may brake, which is the first step of the very manoeuvre whose highest position was looked
at, so that what is left of it has none higher. Whatever is let through meanwhile was looked at in
the same way. At rest inside a bound peak is 0.

Where the wanted acceleration is too much, something between braking (h) and it (w) is taken. Each
of the sums is convex in a', because max is, and so is their maximum: it lies below its chord, and
where the chord from h to w meets the bound, the position does not exceed it.

Braking must keep the speed limit -V, too, at which an acceleration -y can be given up in time if
y + (y - j) + (y - 2 j) + ... <= V + v. The guard brakes only if w would rise: then
v + w + (w - j) + ... > 0, and since w <= 2 j - y for h = -y, v > -3 j + 2 y for y <= j and
v > y - 2 j beyond. What is asked for is then V >= 3 j, and (y - j) + (y - 2 j) + ... <= V - 2 j;
the left side is at most (y - j / 2)^2 / (2 j). Hence b <= j / 2 + sqrt(2 j (V - 2 j)).
What lies between two accelerations that keep limits of jerk, acceleration and speed keeps them.

Above and below never meet: no braking reaches from the middle to a bound.
"""

from __future__ import annotations

import numpy as np

from skewmi.errors import ConfigurationError
from skewmi.robot_models.limits import JointLimits
from skewmi.robot_models.yumi import Array
from skewmi.trajectory import GRID_S

INSIDE = 1e-9
"""How far inside the bounds what is sent is kept, rad, for rounding."""
_TICK2 = GRID_S * GRID_S
_NO_CHORD = 1e-30
"""Stands for a difference of 0 rad, where the wanted acceleration is no more than braking."""


class PositionGuard:
    """Takes acceleration back so far that positions on the grid of 4 ms keep their bounds.

    Args:
        limits: Position bounds, and names for messages.
        speed: Largest speed, rad/s. Shape (7,).
        acceleration: Largest acceleration, rad/s^2. Shape (7,).
        jerk_step: By how much acceleration may change per tick, rad/s^2; at most a third of
            speed / 4 ms. Shape (7,).

    Raises:
        ConfigurationError: The bounds are too near to each other to stop between them.
    """

    def __init__(
        self, limits: JointLimits, speed: Array, acceleration: Array, jerk_step: Array
    ) -> None:
        # Everything in rad and ticks.
        v, j = GRID_S * speed, _TICK2 * jerk_step
        self._jerk = j
        hardest = _TICK2 * acceleration
        self._brake = np.minimum(hardest, 0.5 * j + np.sqrt(2.0 * j * np.maximum(v - 2.0 * j, 0.0)))
        self._middle = 0.5 * (limits.position_lower + limits.position_upper)
        self._half = 0.5 * (limits.position_upper - limits.position_lower) - INSIDE
        # One tick and the time until -b is reached at full speed, and v^2 / 2 b from there.
        longest = v * ((hardest + self._brake) / j + 2.0 + 0.5 * v / self._brake)
        self._free = self._half - longest
        if np.any(self._free < 0.0):
            raise ConfigurationError(
                f"limit profile {limits.name!r}: position bounds {2.0 * self._half} rad from each "
                f"other; what moves at {speed} rad/s can stop within {longest} rad, and half of "
                "them must be more"
            )

    def within(self, q: Array, v: Array, before: Array, wanted: Array) -> Array:
        """The wanted acceleration, or as much of it as leaves room to stop.

        A joint that begins at rest outside its bounds goes no farther out than that.

        Args:
            q, v: Position and velocity so far, rad and rad/s. Shape (..., 7).
            before: Acceleration of the last tick, rad/s^2. Same shape.
            wanted: Of this tick; keeps all other limits. Same shape.

        Returns:
            rad/s^2; `wanted` itself, to the bit, where it does no harm.
        """
        off = q - self._middle
        if not np.any(np.abs(off) > self._free):
            return wanted
        # As if the nearer bound were the upper one.
        side = np.copysign(1.0, off)
        room = np.maximum(self._half - np.abs(off), 0.0)
        asked = side * wanted * _TICK2
        last = side * before * _TICK2
        # Asked for less than that, it may have it: lower accelerations lead to lower positions.
        braking = np.minimum(np.maximum(-self._brake, last - self._jerk), asked)
        both = np.stack((braking, asked))
        beyond_braking, beyond = self._highest(side * v * GRID_S, both) - room
        if not np.any(beyond > 0.0):
            return wanted
        # Outside the bounds, and by rounding, braking itself may be beyond: then it is the part 0.
        chord = np.maximum(beyond - beyond_braking, _NO_CHORD)
        part = np.minimum(np.maximum(-beyond_braking / chord, 0.0), 1.0)
        safe = braking + part * (asked - braking)
        return np.where(beyond > 0.0, side * safe / _TICK2, wanted)

    def _highest(self, v: Array, a: Array) -> Array:
        """Highest of the next positions if after an acceleration nothing but braking follows, rad.

        Args:
            v: Velocity before it, rad/tick.
            a: Of this tick, rad/tick^2.

        Returns:
            From the present position on; below 0 if it only goes down.
        """
        j, b = self._jerk, self._brake
        v = v + a
        # Up while a still falls: v_n = v + n a - j n (n + 1) / 2 >= 0, for n up to (a + b) / j.
        # There is no such n where a is below -b.
        half = a - 0.5 * j
        turn = np.floor((half + np.sqrt(np.maximum(half * half + 2.0 * j * v, 0.0))) / j)
        n = np.maximum(np.minimum(turn, np.floor((a + b) / j)), 0.0)
        pairs = 0.5 * n * (n + 1.0)
        way = n * v + pairs * (a - j * (n + 2.0) / 3.0)
        # Up while a is -b. Where v has turned before, nothing is left, for v_n < b there.
        v_n = v + n * a - j * pairs
        m = np.maximum(np.floor(v_n / b), 0.0)
        way = way + m * (v_n - 0.5 * b * (m + 1.0))
        return v + np.maximum(way, 0.0)
