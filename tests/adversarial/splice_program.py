"""What a robot server admits, as a linear program: how far can chunks go that break no rule?

The rules of `docs/deploy-states.md` are written down here once more, for one joint, and share no
code with skewmi. In units of J h^3 for positions, J h^2 for velocities and J h for accelerations
all of them are linear in the samples that a commander chooses, so that the largest velocity,
acceleration and jerk that any sequence of chunks and stops can add up to is the value of a linear
program, and its solution is the sequence that does it. What counts are differences of the executed
positions on the grid: all that a servo sees.

A rule can be left out (`Rules`): then the program finds what that rule is there for. The sequences
that are looked at are in `splice_sequences`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import csr_matrix, vstack

Array = NDArray[np.float64]

BEFORE = 4
"""Samples at rest that a motion begins with."""
AFTER = 3
"""Samples at rest after its end that are looked at."""


@dataclass(frozen=True)
class Bounds:
    """Bounds of a joint on the grid, in units of its jerk bound."""

    velocity: float
    acceleration: float
    jerk: float = 1.0

    @staticmethod
    def of(velocity: float, acceleration: float, jerk: float, step: float) -> Bounds:
        """From rad/s, rad/s^2, rad/s^3 and the grid step in s."""
        return Bounds(velocity / (jerk * step**2), acceleration / (jerk * step))

    def of_order(self, order: int) -> float:
        """For differences of positions of the first to third order."""
        return (self.velocity, self.acceleration, self.jerk)[order - 1]


LAB = Bounds.of(velocity=np.pi / 2, acceleration=15.0, jerk=800.0, step=0.004)


@dataclass(frozen=True)
class Rules:
    """What is demanded besides the bounds on the samples of a chunk."""

    joined: bool = True
    """Differences over the start and over the end of a chunk are those of one stream: the motion
    before, the chunk, rest. If not, each end is looked at on its own, with the three samples of
    the chunk next to it."""
    rested: int = 2
    """A stop holds the arm at a sample if it equals so many before it. The least is one."""
    remembers: bool = True
    """What was executed before a stop counts for the next chunk. If not, the arm counts as having
    always been where the stop holds it."""


AS_IS = Rules()


class Motion:
    """Samples of one joint by tick, as linear expressions in what the commander chooses.

    It rests at 0 until tick 0. Each row of `q`, `v`, `a` is one tick's expression, the first of
    them that of tick -BEFORE.

    Args:
        points: How many points all chunks have together.
        bounds: Of the joint.
        rules: That apply.
    """

    def __init__(self, points: int, bounds: Bounds = LAB, rules: Rules = AS_IS) -> None:
        self._bounds = bounds
        self.rules = rules
        self._unit = np.eye(3 * points)
        self._used = 0
        rest = np.zeros((BEFORE, 3 * points))
        self.q, self.v, self.a = rest, rest.copy(), rest.copy()
        self._known_since = -BEFORE
        self._upper: list[Array] = []
        self._limits: list[float] = []
        self._equal: list[Array] = []
        self.chunks: list[tuple[int, int, int]] = []
        """Of each chunk: its tick, its points, and the first of its variables."""
        self.held: list[int] = []
        """Where stops have held it."""

    def _bound(self, rows: Iterable[Array], limit: float) -> None:
        for row in rows:
            self._upper.append(row)
            self._limits.append(limit)

    def _at(self, series: Array, tick: int) -> Array:
        row: Array = series[min(max(tick + BEFORE, 0), len(series) - 1)]
        return row

    def _padded(self, series: Array, ticks: int) -> Array:
        """Up to and without a tick; at rest after the end."""
        return series[np.minimum(np.arange(ticks + BEFORE), len(series) - 1)]

    def chunk(self, tick: int, points: int) -> None:
        """Lay a chunk over the motion from a tick on, such that it breaks no rule."""
        first = self._used
        q, v, a = self._unit[first : first + 3 * points].reshape(3, points, -1)
        self._used += 3 * points
        self.chunks.append((tick, points, first))
        # It starts on the motion that it continues, and ends at rest.
        for new, old in ((q, self.q), (v, self.v), (a, self.a)):
            self._equal.append(new[0] - self._at(old, tick))
        self._equal += [v[-1], a[-1]]
        self._within(q, v, a)
        self._one_motion(q, v, a)
        known = [max(tick - age, self._known_since) for age in (3, 2, 1)]
        earlier = [self._at(self.q, known_tick) for known_tick in known]
        rest = [q[-1]] * AFTER
        if self.rules.joined:
            self._differences(np.array([*earlier, *q, *rest]))
        else:
            self._differences(np.array([*earlier, *q[:3]]))
            self._differences(np.array([*q[-3:], *rest]))
        self.q = np.concatenate((self._padded(self.q, tick), q))
        self.v = np.concatenate((self._padded(self.v, tick), v))
        self.a = np.concatenate((self._padded(self.a, tick), a))

    def _within(self, q: Array, v: Array, a: Array) -> None:
        """Bounds on samples, and on differences that lie inside the chunk."""
        bounds = self._bounds
        self._bound(v, bounds.velocity)
        self._bound(a, bounds.acceleration)
        self._bound(np.diff(v, axis=0), bounds.acceleration)
        self._bound(np.diff(v, n=2, axis=0), bounds.jerk)
        self._bound(np.diff(a, axis=0), bounds.jerk)
        self._differences(q)

    def _differences(self, q: Array) -> None:
        for order in (1, 2, 3):
            self._bound(np.diff(q, n=order, axis=0), self._bounds.of_order(order))

    def _one_motion(self, q: Array, v: Array, a: Array) -> None:
        """Taylor's theorem from each sample to the next, and from that one back."""
        dq, dv = np.diff(q, axis=0), np.diff(v, axis=0)
        self._bound(dv - a[:-1], 1 / 2)
        self._bound(dv - a[1:], 1 / 2)
        self._bound(dq - v[:-1] - a[:-1] / 2, 1 / 6)
        self._bound(dq - v[1:] + a[1:] / 2, 1 / 6)

    def hold(self, tick: int) -> None:
        """A stop finds the arm at rest at a tick: there it stays."""
        self._equal += [self._at(self.v, tick), self._at(self.a, tick)]
        for age in range(1, self.rules.rested + 1):
            self._equal.append(self._at(self.q, tick) - self._at(self.q, tick - age))
        self.q, self.v, self.a = (self._padded(x, tick + 1) for x in (self.q, self.v, self.a))
        self.held.append(tick)
        if not self.rules.remembers:
            self._known_since = tick

    @property
    def executed(self) -> Array:
        """Positions by tick, rest before and after included; see `q`."""
        return self._padded(self.q, len(self.q) - BEFORE + AFTER)

    def worst(self, ticks: Iterable[int] | None = None, orders: Iterable[int] = (1, 2, 3)) -> Worst:
        """The largest difference of executed positions that the rules allow.

        Args:
            ticks: Where differences begin; everywhere if None.
            orders: Of the differences: 1 is velocity, 2 acceleration, 3 jerk.
        """
        executed, program, found = self.executed, self._program(), Worst()
        for tick in range(-3, len(self.q) - BEFORE) if ticks is None else ticks:
            for order in orders:
                window = executed[tick + BEFORE : tick + BEFORE + order + 1]
                if len(window) <= order:
                    continue
                solution = _solve(np.diff(window, n=order, axis=0)[0], program)
                share = float(np.diff(window @ solution, n=order)[0]) / self._bounds.of_order(order)
                if share > found.share:
                    found = Worst(share, order, tick, solution)
        return found

    def any_of(self, rng: np.random.Generator) -> Array:
        """Values of the variables at a random corner of all that is allowed."""
        return _solve(rng.normal(size=len(self._unit)), self._program())

    def samples(self, number: int, solution: Array) -> Array:
        """Position, velocity and acceleration of a chunk in a solution. Shape (3, points)."""
        _, points, first = self.chunks[number]
        values: Array = solution[first : first + 3 * points].reshape(3, points)
        return values

    def _program(self) -> dict[str, Any]:
        assert self._used == len(self._unit), "as many points as were asked for"
        rows = csr_matrix(np.array(self._upper))
        return {
            "A_ub": vstack((rows, -rows)).tocsr(),
            "b_ub": np.tile(self._limits, 2),
            "A_eq": csr_matrix(np.array(self._equal)),
            "b_eq": np.zeros(len(self._equal)),
        }


@dataclass(frozen=True)
class Worst:
    """A largest difference of executed positions."""

    share: float = 0.0
    """Of its bound."""
    order: int = 0
    tick: int = 0
    """Where it begins."""
    solution: Array = field(default_factory=lambda: np.zeros(0))
    """Values of the variables."""


def _solve(goal: Array, program: dict[str, Any]) -> Array:
    """What makes `goal` as large as the program allows."""
    if not goal.any():
        return np.zeros(len(goal))
    found = linprog(-goal, bounds=(None, None), method="highs", **program)
    assert found.status == 0, found.message
    solution: Array = found.x
    return solution
