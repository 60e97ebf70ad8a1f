"""The runs of a sweep as figures need them: by group, configuration, task and target."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.policy_io import Array
from skewmi.sweep.tables import RUN, Columns, Tables


@dataclass(frozen=True)
class Curve:
    """A column of a run's table, where it has a value.

    Attributes:
        x: Ascending. Shape (n,).
        y: Shape (n,).
        ended: Whether the run has, so that no more values come.
    """

    x: Array
    y: Array
    ended: bool

    def at(self, x: Array, *, hold: bool) -> Array:
        """Values in between, straight lines; outside NaN, or with `hold` the last one after it."""
        right = self.y[-1] if hold else math.nan
        values: Array = np.interp(x, self.x, self.y, left=math.nan, right=right)
        return values


@dataclass(frozen=True)
class Entry:
    """A run in its place in a group.

    Attributes:
        facts: Its row of the results.
        table: Its rows of the curves, columns by name, NaN where there is no value.
    """

    facts: dict[str, Any]
    table: dict[str, Array]

    @property
    def name(self) -> str:
        """Of the run."""
        return str(self.facts[RUN])

    def curve(self, x: str, y: str) -> Curve | None:
        """One column over another; None if there is no point of it."""
        if x not in self.table or y not in self.table:
            return None
        known = np.isfinite(self.table[x]) & np.isfinite(self.table[y])
        if not known.any():
            return None
        ascending = np.maximum.accumulate(self.table[x][known])
        return Curve(ascending, self.table[y][known], self.facts.get("state") == "done")


class SweepRuns:
    """All runs of a sweep.

    Args:
        tables: What it came to.
    """

    def __init__(self, tables: Tables) -> None:
        self.states = tables.states
        parts = _by_run(tables.curves)
        names = list(tables.results)
        rows = zip(*tables.results.values(), strict=True)
        self.entries = [
            Entry(facts := dict(zip(names, row, strict=True)), parts.get(facts[RUN], {}))
            for row in rows
        ]

    def of(self, groups: Sequence[str], **facts: object) -> list[Entry]:
        """Runs of some groups, and of those facts.

        Groups may share runs: each is there once per configuration, in the first group's place.

        Raises:
            NotFoundError: There is no such group.
        """
        known = list(dict.fromkeys(entry.facts["group"] for entry in self.entries))
        for group in groups:
            if group not in known:
                raise NotFoundError(
                    f"no group {group!r} in these results; groups are {', '.join(known)}"
                )
        found: dict[tuple[str, str], Entry] = {}
        for entry in self.entries:
            if entry.facts["group"] in groups and all(
                entry.facts.get(name) == value for name, value in facts.items()
            ):
                found.setdefault((entry.facts["configuration"], entry.name), entry)
        return list(found.values())

    def states_of(self, run: str) -> dict[str, Array]:
        """Kept states of a run: `trajectory` and the fields that it has; empty if none are kept."""
        if not self.states:
            return {}
        mine = np.array([name == run for name in self.states[RUN]], dtype=np.bool_)
        if not mine.any():
            return {}
        found = {}
        for name, values in self.states.items():
            if name != RUN:
                column = np.array(values, dtype=np.float64)[mine]
                if np.isfinite(column).all():
                    found[name] = column
        return found


def _by_run(curves: Columns) -> dict[str, dict[str, Array]]:
    if not curves:
        return {}
    runs = np.array(curves[RUN])
    columns = {
        name: np.array(values, dtype=np.float64)
        for name, values in curves.items()
        if name != RUN and any(isinstance(value, int | float) for value in values)
    }
    return {
        str(run): {name: column[runs == run] for name, column in columns.items()}
        for run in np.unique(runs)
    }


def distinct(entries: Iterable[Entry], fact: str) -> list[Any]:
    """Values of a fact, in the order of the sweep file."""
    return list(dict.fromkeys(entry.facts.get(fact) for entry in entries))


def each_once(entries: Iterable[Entry]) -> list[Entry]:
    """One entry per run, its first, also where several configurations ask for it."""
    found: dict[str, Entry] = {}
    for entry in entries:
        found.setdefault(entry.name, entry)
    return list(found.values())


def missing(entries: Sequence[Entry]) -> list[str]:
    """What of some runs is not there or not finished, a line per group, configuration and task."""
    places: dict[tuple[str, ...], list[str]] = {}
    for entry in entries:
        f = entry.facts
        target = [f"target {f['target']}"] if f.get("target") else []
        key = (f"{f['group']}/{f['configuration']}", f["task"], *target)
        places.setdefault(key, []).append(str(f.get("state")))
    lines = []
    for (what, *where), states in places.items():
        waiting, begun = states.count("waiting"), states.count("begun")
        if waiting or begun:
            words = [f"{waiting} have not begun"] * bool(waiting)
            words += [f"{begun} have not ended"] * bool(begun)
            lines.append(f"{what}, {', '.join(where)}: of {len(states)} runs {', '.join(words)}")
    return lines


@dataclass(frozen=True)
class Band:
    """Mean and deviation of curves on one grid; all shapes (n,).

    Attributes:
        x: The grid.
        mean: Over the runs that have a value there.
        deviation: Their standard deviation (n - 1), 0 of a single one.
        runs: How many these are.
    """

    x: Array
    mean: Array
    deviation: Array
    runs: Array


def band(curves: Sequence[Curve], *, hold: bool = False, points: int = 200) -> Band:
    """Mean and deviation of curves.

    Args:
        curves: At least one.
        hold: Whether a run that has ended keeps its last value, as one that was stopped because
            it had converged; otherwise it counts as far as it goes, as one that goes on does
            in any case.
        points: Of the grid.
    """
    grid = np.unique(np.concatenate([curve.x for curve in curves]))
    if len(grid) > points:
        grid = np.linspace(grid[0], grid[-1], points)
    values = np.stack([curve.at(grid, hold=hold and curve.ended) for curve in curves])
    known = np.isfinite(values)
    runs = known.sum(0)
    some = runs > 0
    grid, values, known, runs = grid[some], values[:, some], known[:, some], runs[some]
    total = np.where(known, values, 0.0)
    mean = total.sum(0) / runs
    square = (np.where(known, values - mean, 0.0) ** 2).sum(0)
    return Band(grid, mean, np.sqrt(square / np.maximum(runs - 1, 1)), runs)


def spread(values: Sequence[float]) -> tuple[float, float]:
    """Mean, and standard deviation (n - 1), 0 of a single value.

    Raises:
        ConfigurationError: There is none.
    """
    if not values:
        raise ConfigurationError("there is no value to take a mean of")
    deviation = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
    return float(np.mean(values)), deviation
