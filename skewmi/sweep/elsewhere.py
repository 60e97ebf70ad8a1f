"""Runs of a sweep that are done somewhere else, on machines that share no disk with this one.

A run is what it computes, and its name says that. So a row of another folder's results stands for
the run here if it is done and its configuration is the same.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from skewmi.errors import ConfigurationError
from skewmi.sweep.plan import Plan, Run, differences
from skewmi.sweep.run_folder import is_done
from skewmi.sweep.tables import RUN, Columns, joined, read_tables, rows_of
from skewmi.train.config_json import from_document

_NUMBERS = ("steps", "seconds")
"""Columns that a listing of runs counts with."""


@dataclass(frozen=True)
class Elsewhere:
    """What other folders have of a plan's runs.

    Attributes:
        rows: Of their results, by run.
        curves, states: Of those runs alone.
    """

    rows: dict[str, dict[str, Any]] = field(default_factory=dict)
    curves: Columns = field(default_factory=dict)
    states: Columns = field(default_factory=dict)


def read_elsewhere(plan: Plan, runs: Path, paths: Iterable[Path]) -> Elsewhere:
    """The runs of a plan that are done in other folders and not in this one.

    Args:
        plan: Of the sweep.
        runs: Folder of the runs' folders here.
        paths: Folders of sweeps or their results.parquet or results.csv. Of a run that several
            have, the first one's.

    Raises:
        NotFoundError: A path has no results.
        ConfigurationError: They are damaged, or a run was done with other numbers.
    """
    wanted = {run.name: run for run in plan.runs if not is_done(runs / run.name)}
    rows: dict[str, dict[str, Any]] = {}
    curves: list[Columns] = []
    states: list[Columns] = []
    for path in paths:
        tables = read_tables(path)
        done = {
            row[RUN]: row
            for row in rows_of(tables.results)
            if row[RUN] in wanted and row[RUN] not in rows and row.get("state") == "done"
        }
        for name, row in done.items():
            _require_same(wanted[name], row, path)
        rows |= done
        curves.append(_of(done, tables.curves))
        states.append(_of(done, tables.states))
    return Elsewhere(rows, joined(curves), joined(states))


def _require_same(run: Run, row: dict[str, Any], path: Path) -> None:
    try:
        theirs = from_document(json.loads(row["config"]))
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigurationError(f"{path}: run {run.name} has no configuration") from error
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: run {run.name}: {error}") from error
    for name in _NUMBERS:
        if not isinstance(row.get(name), int | float | None):
            raise ConfigurationError(
                f"{path}: {name} of run {run.name} is {row[name]!r}; it must be a number"
            )
    differing = differences(run.config, replace(theirs, threads=run.config.threads))
    if differing:
        raise ConfigurationError(
            f"the run {run.name} in {path} was done with {', '.join(differing)}: its preset or "
            "task has changed since; leave these results out, or ask for other groups or tasks"
        )


def _of(names: Collection[str], columns: Columns) -> Columns:
    """The rows of some runs."""
    chosen: Sequence[int] = [k for k, name in enumerate(columns.get(RUN, [])) if name in names]
    return {name: [values[k] for k in chosen] for name, values in columns.items()}
