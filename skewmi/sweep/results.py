"""Reading what the runs of a sweep came to, finished or not, into tables."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skewmi.errors import CheckpointError
from skewmi.outputs import written_aside
from skewmi.sweep.elsewhere import Elsewhere
from skewmi.sweep.plan import TARGET, Member, Plan, Run
from skewmi.sweep.run_folder import read_parts, read_result
from skewmi.sweep.tables import RUN, Columns, Tables, as_columns, joined
from skewmi.train.checkpoint import read_checkpoint, read_run_header
from skewmi.train.config_json import to_document
from skewmi.train.log import read_metrics
from skewmi.train.registry import entry_of
from skewmi.train.visited import visited_trajectories

MOST_STATES = 12_000
"""Visited states kept of a run, evenly spaced in time."""
MOST_MEASURED, MOST_OTHERS = 100, 60
"""Rows kept of a run's table: with an entropy, and evenly spaced ones; and the last."""
DIGITS = 6
"""Significant ones of values in the curves: there are many of them."""
_STATES = "states.npz"


def collect(
    plan: Plan, runs: Path, figures: Mapping[str, Any], elsewhere: Elsewhere | None = None
) -> Tables:
    """What there is of a plan.

    Args:
        plan: Of the sweep.
        runs: Folder of the runs' folders.
        figures: Of the sweep file.
        elsewhere: Runs that other folders have; what there is of them here is left out.

    Raises:
        CheckpointError: A run is damaged.
    """
    others = elsewhere or Elsewhere()
    own = [run for run in plan.runs if run.name not in others.rows]
    tables = {run.name: _metrics(runs / run.name) for run in own}
    facts = {run.name: _facts(run, runs / run.name, tables[run.name]) for run in own}
    facts |= others.rows
    # The place comes first, and a row from elsewhere has another one.
    rows = [
        {**_place(member), **facts[member.run.name], **_place(member)} for member in plan.members
    ]
    kept = {member.run.name for member in plan.members if member.keep_states}
    return Tables(
        results=as_columns(rows),
        curves=joined([_curves(tables), others.curves]),
        states=joined([_states([run for run in own if run.name in kept], runs), others.states]),
        figures=dict(figures),
    )


def _place(member: Member) -> dict[str, Any]:
    return {"group": member.group, "configuration": member.configuration}


def _facts(run: Run, run_dir: Path, table: dict[str, list[float]]) -> dict[str, Any]:
    """A row of the results: what the run is, where it stands, and its last measurements."""
    config = run.config
    result = read_result(run_dir)
    state = _state(run_dir) or {}
    parts = read_parts(run_dir)
    discoveries = state.get("discoveries") or {}
    return {
        "task": config.task,
        "target": dict(config.task_options).get(TARGET),
        "preset": config.preset,
        "learner": entry_of(config.learner)[0],
        "exploration": entry_of(config.exploration)[0],
        "sigma": getattr(config.exploration, "sigma", None),
        "seed": config.seed,
        "commit": _all_of(parts, "version"),
        "kernels": _all_of(parts, "kernels"),
        "state": "done" if result else "begun" if table else "waiting",
        "stopped_by": (result or {}).get("stopped_by"),
        "steps": int(_last(table, "step") or 0),
        "trajectories": int(_last(table, "trajectories") or 0),
        "converged_at": state.get("converged_at"),
        "converged_at_paper": state.get("converged_at_paper"),
        "discoveries": json.dumps({k: v["trajectory"] for k, v in discoveries.items()}),
        "total_steps": config.total_steps,
        **{name: _last(table, name) for name in table if name not in ("step", "trajectories")},
        RUN: run.name,
        "changes": json.dumps(dict(run.changes)),
        "config": json.dumps(to_document(config)),
    }


def _all_of(parts: Iterable[Mapping[str, Any]], name: str) -> str | None:
    """What the parts of a run had there, each value once; None where nobody noted it."""
    values = [part.get(name) for part in parts]
    return " ".join(dict.fromkeys(v or "unknown" for v in values)) if any(values) else None


def _last(table: Mapping[str, list[float]], name: str) -> float | None:
    """The last value of a column that is one."""
    return next((v for v in reversed(table.get(name, [])) if math.isfinite(v)), None)


def _state(run_dir: Path) -> dict[str, Any] | None:
    try:
        return read_checkpoint(run_dir).state
    except CheckpointError:
        # A run that has just begun; a damaged one its own worker refuses.
        return None


def _metrics(run_dir: Path) -> dict[str, list[float]]:
    try:
        return read_metrics(run_dir)
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, TypeError):
        # A worker may be writing its last row at this moment.
        return _whole_rows(run_dir)


def _whole_rows(run_dir: Path) -> dict[str, list[float]]:
    names, *lines = (run_dir / "metrics.csv").read_text().split("\n")
    columns = names.split(",")
    rows = [line.split(",") for line in lines[:-1]]
    return {
        name: [float(row[k] or "nan") for row in rows if len(row) == len(columns)]
        for k, name in enumerate(columns)
    }


def _curves(tables: Mapping[str, dict[str, list[float]]]) -> Columns:
    rows: list[dict[str, Any]] = []
    for run, table in tables.items():
        for k in _kept_rows(table):
            values = {name: column[k] for name, column in table.items()}
            shown = {n: _rounded(v) for n, v in values.items() if math.isfinite(v)}
            rows.append({RUN: run} | shown)
    return as_columns(rows)


def _rounded(value: float) -> float:
    # Counters are longer than that, and whole.
    return value if value.is_integer() else float(f"{value:.{DIGITS}g}")


def _kept_rows(table: Mapping[str, list[float]]) -> list[int]:
    count = len(table.get("step", []))
    if not count:
        return []
    measured = np.flatnonzero(np.isfinite(table.get("entropy", [math.nan] * count)))
    kept = {*_spaced(measured.tolist(), MOST_MEASURED), *_spaced(range(count), MOST_OTHERS)}
    return sorted({*kept, count - 1})


def _spaced(rows: Sequence[int], most: int) -> list[int]:
    """At most so many of some rows, evenly spaced, both ends among them."""
    if len(rows) <= most:
        return list(rows)
    return [rows[k] for k in np.linspace(0, len(rows) - 1, most).round().astype(int)]


def _states(kept: list[Run], runs: Path) -> Columns:
    parts: dict[str, list[Any]] = {}
    for run in kept:
        states = _visited(runs / run.name)
        if states is None:
            continue
        count = len(states["trajectory"])
        before = len(parts.get(RUN, []))
        for name, array in {RUN: np.repeat(run.name, count), **states}.items():
            # Tasks have other fields: what a run does not have is None.
            parts.setdefault(name, [None] * before).extend(array.tolist())
        for column in parts.values():
            column.extend([None] * (before + count - len(column)))
    return parts


def _visited(run_dir: Path) -> dict[str, np.ndarray[Any, Any]] | None:
    """Thinned states of a run by field, with their trajectories; kept beside a run that is done."""
    cache = run_dir / _STATES
    result = read_result(run_dir)
    if cache.exists():
        with np.load(cache, allow_pickle=False) as file:
            found = {name: file[name] for name in file.files}
        # They were once numbered from 1 also where the last alone were held.
        if result and found["trajectory"][-1] == result.get("trajectories"):
            return found
    try:
        states, numbers = visited_trajectories(run_dir)
        _, layout = read_run_header(run_dir)
    except (CheckpointError, OSError):
        # Not begun, or its worker is replacing the checkpoint at this moment.
        return None
    trajectories = np.repeat(numbers, states.shape[1])
    flat = states.reshape(-1, states.shape[-1])
    chosen = np.unique(np.linspace(0, len(flat) - 1, min(len(flat), MOST_STATES)).astype(int))
    names = [field.name for field in layout.state_fields]
    found = {"trajectory": trajectories[chosen].astype(np.int32)}
    found |= {name: flat[chosen, k].astype(np.float32) for k, name in enumerate(names)}
    if result:
        with written_aside(cache) as draft:
            np.savez_compressed(draft, **found)
    return found
