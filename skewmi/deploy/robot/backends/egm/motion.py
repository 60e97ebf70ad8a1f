"""What an arm's packets tell of its motion: its speed, and how late it is behind its commands."""

from __future__ import annotations

from collections import deque

import numpy as np

from skewmi.trajectory import Array

_SPAN = 6
"""Positions that a speed is taken from: 5 cycles, 20 ms."""

_MEMORY_S = 5.0
"""Of motion; what is older has faded from the delay."""

_STEP_S = 0.004
_DELAYS_S = np.arange(0.0, 0.1501, _STEP_S)
"""Candidates."""

_REMEMBERED = 40
"""Commands, 4 ms or more apart: a little more than the longest candidate."""

_LOOKED_AT = 5
"""Cycles: 20 ms."""

_STILL = 1e-3
"""rad: an arm that is not commanded further in this time says nothing about delays."""

_ENOUGH = 1.5e-3
"""rad^2/s: variations of the speed by 0.05 rad/s for half a second."""

_UNEXPLAINED = 0.1
"""Part of the motion that is at most left over by the delay that is found."""


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

    An arm that does at time t what it was commanded at t - d leaves, for each candidate d,

        S(d) = sum over joints of the variance of (measured(t) - commanded(t - d))

    over the motion of the last seconds, which fades with time; the least S is where the delay is,
    and a parabola through its neighbors finds it between two candidates. Of a variance, because an
    arm that sags by a constant is not late. S is curved by how much the speed varies: an arm that
    rests, or that slides evenly, says nothing. Nor does one that does not do what it is told.
    """

    def __init__(self) -> None:
        self._times = np.zeros(_REMEMBERED)
        self._commands = np.zeros((_REMEMBERED, 7))
        self._known = 0
        self._weight = 0.0
        self._sums = np.zeros((len(_DELAYS_S), 7))
        self._squares = np.zeros((len(_DELAYS_S), 7))

    def forget_way(self) -> None:
        """What was commanded so far is not on its way any more: a session has ended."""
        self._known = 0

    def add(self, time_s: float, commanded_q: Array, measured_q: Array) -> None:
        """Take in a cycle, oldest first; each fifth is looked at.

        Args:
            time_s: Of the measurement.
            commanded_q: What holds at that time, rad. Shape (7,).
            measured_q: rad. Shape (7,).
        """
        for history, newest in ((self._times, time_s), (self._commands, commanded_q)):
            history[:-1] = history[1:]
            history[-1] = newest
        self._known += 1
        if self._known < _REMEMBERED or self._known % _LOOKED_AT:
            return
        if np.ptp(self._commands, axis=0).max() < _STILL:
            return
        dt_s = time_s - float(self._times[-1 - _LOOKED_AT])
        fades = np.exp(-dt_s / _MEMORY_S)
        late = measured_q - self._commanded(time_s - _DELAYS_S)
        self._weight = fades * self._weight + dt_s
        self._sums = fades * self._sums + dt_s * late
        self._squares = fades * self._squares + dt_s * late**2

    @property
    def delay_s(self) -> float | None:
        """s, from 0 on; None before enough motion has been seen, or if none explains it."""
        if self._weight == 0.0:
            return None
        left = (self._squares - self._sums**2 / self._weight).sum(axis=1)
        best = int(np.argmin(left))
        if best == len(left) - 1 or left[best] > _UNEXPLAINED * left.max():
            return None
        middle = max(best, 1)
        below, at, above = left[middle - 1 : middle + 2]
        # S is curved by twice the sum of (speed less its mean) squared.
        curvature = (below - 2.0 * at + above) / _STEP_S**2
        if curvature < 2.0 * _ENOUGH:
            return None
        offset = 0.5 * (below - above) / (below - 2.0 * at + above)
        return max(0.0, float(_DELAYS_S[middle] + _STEP_S * offset))

    def _commanded(self, times_s: Array) -> Array:
        """Between what was commanded at the cycles before. Shape (n,) -> (n, 7)."""
        after = np.clip(np.searchsorted(self._times, times_s), 1, _REMEMBERED - 1)
        span = np.maximum(self._times[after] - self._times[after - 1], 1e-9)
        part = np.clip((times_s - self._times[after - 1]) / span, 0.0, 1.0)[:, None]
        commanded: Array = (1.0 - part) * self._commands[after - 1] + part * self._commands[after]
        return commanded
