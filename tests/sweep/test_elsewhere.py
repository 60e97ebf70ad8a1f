"""Runs that are done in other folders count as done here, if they are the same runs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.sweep.elsewhere import read_elsewhere
from skewmi.sweep.places import RESULT
from skewmi.sweep.plan import Plan, Run, make_plan
from skewmi.sweep.results import collect
from skewmi.sweep.sweep_file import parse_sweep
from skewmi.sweep.tables import Tables, as_columns, write_tables
from skewmi.train.config import TrainConfig
from skewmi.train.config_json import to_document
from skewmi.train.presets import default_preset


def start(task: str, preset: str) -> TrainConfig:
    return replace(default_preset(task), preset=preset)


@pytest.fixture
def plan() -> Plan:
    text = "seeds: 3\ngroups:\n  g: {tasks: [point_maze], configurations: [{name: '7', preset: a}]}"
    return make_plan(parse_sweep(text, "f"), start)


def row(run: Run, **content: Any) -> dict[str, Any]:
    """Of the results of another folder, in which the run stands somewhere else."""
    where = {"group": "other", "configuration": "theirs", "task": run.config.task}
    facts = {"state": "done", "steps": 100, "seconds": 1.5, "entropy": 40.0 + run.config.seed}
    config = json.dumps(to_document(run.config))
    return {**where, "run": run.name, "seed": run.config.seed, **facts, "config": config, **content}


def write(folder: Path, rows: Sequence[dict[str, Any]]) -> Path:
    points = [{"run": r["run"], "step": s, "entropy": r["entropy"]} for r in rows for s in (1, 2)]
    states = [{"run": r["run"], "trajectory": 1, "x": 0.5} for r in rows]
    folder.mkdir()
    write_tables(Tables(as_columns(rows), as_columns(points), as_columns(states)), folder)
    return folder


@pytest.mark.parametrize("name", ["", "results.parquet", "results.csv"])
def test_their_rows_stand_in_the_results_in_the_place_that_is_asked_for(
    tmp_path: Path, plan: Plan, name: str
) -> None:
    there = write(tmp_path / "there", [row(run) for run in plan.runs[1:]])
    if name == "results.csv":
        for path in there.glob("*.parquet"):
            path.unlink()
    elsewhere = read_elsewhere(plan, tmp_path / "runs", [there / name])
    assert set(elsewhere.rows) == {run.name for run in plan.runs[1:]}
    found = collect(plan, tmp_path / "runs", {}, elsewhere)
    assert found.results["group"] == ["g"] * 3
    assert found.results["configuration"] == ["7"] * 3
    assert found.results["state"] == ["waiting", "done", "done"]
    assert found.results["entropy"] == [None, 41.0, 42.0]
    names = [run.name for run in plan.runs]
    assert found.curves["run"] == [names[1]] * 2 + [names[2]] * 2
    assert found.curves["entropy"] == [41.0, 41.0, 42.0, 42.0]
    assert found.states.get("run", []) == ([] if name == "results.csv" else names[1:])
    # What was collected can be given on.
    write_tables(found, tmp_path)
    again = read_elsewhere(plan, tmp_path / "runs", [tmp_path])
    assert again.rows[names[2]]["entropy"] == 42.0
    assert collect(plan, tmp_path / "runs", {}, again) == found


def test_a_run_counts_once(tmp_path: Path, plan: Plan) -> None:
    """As the first of the folders has it, and not at all where it is done here."""
    first, second, third = plan.runs
    one = write(tmp_path / "one", [row(first), row(second, entropy=1.0)])
    two = write(tmp_path / "two", [row(second, entropy=2.0), row(third, state="begun")])
    (tmp_path / "runs" / first.name).mkdir(parents=True)
    (tmp_path / "runs" / first.name / RESULT).write_text("{}")
    elsewhere = read_elsewhere(plan, tmp_path / "runs", [one, two])
    assert {name: found["entropy"] for name, found in elsewhere.rows.items()} == {second.name: 1.0}
    assert elsewhere.curves["run"] == [second.name] * 2
    assert elsewhere.curves["entropy"] == [1.0] * 2


def test_a_run_that_was_another_one_is_refused(tmp_path: Path, plan: Plan) -> None:
    run = plan.runs[0]
    document = to_document(replace(run.config, total_steps=123, threads=7))
    there = write(tmp_path / "there", [row(run, config=json.dumps(document))])
    with pytest.raises(ConfigurationError, match=r"total_steps 123 \(now") as caught:
        read_elsewhere(plan, tmp_path / "runs", [there])
    assert "threads" not in str(caught.value)  # says nothing of what is computed


@pytest.mark.parametrize("config", [None, "no JSON", "[]", '{"learner": 1}'])
def test_a_damaged_row_is_refused(tmp_path: Path, plan: Plan, config: str | None) -> None:
    rows = [row(plan.runs[0], config=config), row(plan.runs[1])]
    there = write(tmp_path / "there", rows)
    with pytest.raises(ConfigurationError, match=plan.runs[0].name):
        read_elsewhere(plan, tmp_path / "runs", [there])


@pytest.mark.parametrize("column", ["steps", "seconds"])
def test_a_number_that_is_none_is_refused(tmp_path: Path, plan: Plan, column: str) -> None:
    there = write(tmp_path / "there", [row(plan.runs[0], **{column: "half an hour"})])
    with pytest.raises(ConfigurationError, match=f"{column} of run .* 'half an hour'"):
        read_elsewhere(plan, tmp_path / "runs", [there])


def test_results_that_are_not_there_are_refused(tmp_path: Path, plan: Plan) -> None:
    with pytest.raises(NotFoundError, match="no results"):
        read_elsewhere(plan, tmp_path / "runs", [tmp_path])
