"""What an arm's packets tell of its motion: its speed, and how late it is behind its commands."""

from __future__ import annotations

from collections import deque

import numpy as np

from skewmi.trajectory import Array

_SPAN = 6
"""Positions that a speed is taken from: 5 cycles, 20 ms."""

_SLOWEST = 0.02
"""rad/s: a slower joint says nothing about delays."""

_MEMORY_S = 5.0
"""Of motion; what is older has faded from the delay."""


class SpeedEstimate:
    """Speed of the joints, from positions alone: EGM tells no other."""

    def __init__(self) -> None:
        self._history: deque[tuple[float, Array]] = deque(maxlen=_SPAN)

    def forget(self) -> None:
        """The arm may be elsewhere now."""
        self._history.clear()

    def add(self, time_ns: float, q: Array) -> Array:
        """Speed over the last cycles.

        Args:
            time_ns: Of the measurement.
            q: Measured, rad. Shape (7,).

        Returns:
            rad/s, zero at first. Shape (7,).
        """
        self._history.append((time_ns, q))
        first_ns, first_q = self._history[0]
        if time_ns <= first_ns:
            return np.zeros_like(q)
        speed: Array = (q - first_q) / ((time_ns - first_ns) / 1e9)
        return speed


class DelayEstimate:
    """How late an arm is behind its commands, in one number.

    An arm that does in time t what it was commanded at t - d is behind by d v. Over the motion of
    the last seconds, the d that leaves the least squares is

        d = sum (commanded - measured) v / sum v^2

    of which the sums fade with time. Standing joints count for nothing.
    """

    def __init__(self) -> None:
        self._behind = 0.0
        self._motion = 0.0

    @property
    def delay_s(self) -> float | None:
        """s; None before a motion of half a second or so has been seen."""
        return self._behind / self._motion if self._motion > 0.5 * _SLOWEST**2 * 7 else None

    def add(self, commanded_q: Array, commanded_v: Array, measured_q: Array, dt_s: float) -> None:
        """Take in a cycle.

        Args:
            commanded_q: What holds at the time of the measurement, rad. Shape (7,).
            commanded_v: Its speed, rad/s. Shape (7,).
            measured_q: rad. Shape (7,).
            dt_s: Length of the cycle.
        """
        moving = np.abs(commanded_v) > _SLOWEST
        if not moving.any():
            return
        fades = np.exp(-dt_s / _MEMORY_S)
        v = np.where(moving, commanded_v, 0.0)
        self._behind = fades * self._behind + dt_s * float((commanded_q - measured_q) @ v)
        self._motion = fades * self._motion + dt_s * float(v @ v)
