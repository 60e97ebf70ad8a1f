"""Figures of made-up results: what they show is in their CSV, and they are drawn."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from skewmi.errors import ConfigurationError
from skewmi.evaluation.sweep_figures.figure import COLOURS, Drawn, read_request
from skewmi.evaluation.sweep_figures.kinds import KINDS, draw
from skewmi.evaluation.sweep_figures.runs import SweepRuns
from skewmi.evaluation.sweep_figures.visits import Scene
from skewmi.sim import tasks
from skewmi.sweep.tables import Tables, as_columns

Rows = list[dict[str, Any]]
Make = Callable[[Rows], SweepRuns]


def scenes() -> dict[str, Scene]:
    spec = tasks.find("point_maze")
    layouts = {name: spec.layout(target=name) for name in spec.targets}
    reachable = tasks.make_batch("point_maze", 1, num_threads=1).reachable
    return {"maze": Scene(layouts, ("x", "y"), reachable)}


def drawn(folder: Path, runs: SweepRuns, **content: Any) -> tuple[Drawn, list[dict[str, str]]]:
    """Draw a figure, see that its three files are good, and read its CSV."""
    request = read_request("f", {"groups": ["g"], **content}, KINDS)
    result = draw(request, runs, scenes(), folder / "f", dpi=30)
    if not result.files:
        return result, []
    png, svg, table = result.files
    assert [path.name for path in result.files] == ["f.png", "f.svg", "f.csv"]
    assert np.ptp(imread(png)[..., :3]) > 0.5
    assert "<svg" in svg.read_text()[:600]
    with table.open(newline="") as file:
        return result, list(csv.DictReader(file))


def test_exploration_is_a_band_per_configuration_metric_and_task(
    tmp_path: Path, make_runs: Make, rows: Rows
) -> None:
    paper = {"maze": {"two": {"entropy": 21.5}}}
    result, table = drawn(
        tmp_path, make_runs(rows), draw="exploration", metrics=["entropy", "covered_cells"],
        paper=paper,
    )  # fmt: skip
    assert result.missing == ()
    last = [r for r in table if r["trajectories"] == "100" and r["metric"] == "entropy"]
    assert [(r["task"], r["configuration"], float(r["mean"])) for r in last] == [
        ("maze", "one", 11.0), ("maze", "two", 21.0), ("door", "one", 11.0), ("door", "two", 21.0),
    ]  # fmt: skip
    assert all(float(r["deviation"]) == pytest.approx(1.0) and r["runs"] == "3" for r in last)


@pytest.mark.parametrize(("kind", "more"), [("exploration", {"metrics": ["entropy"]}),
                                           ("learning", {"metric": "entropy"})])  # fmt: skip
@pytest.mark.parametrize("configurations", [{"one"}, {"one", "two"}])
def test_a_single_measurement_is_seen(
    tmp_path: Path, rows: Rows, kind: str, more: dict[str, Any], configurations: set[str]
) -> None:
    """Of a sweep that was tried out: the panel alone, without the legend, has its colours."""
    rows = [r for r in rows if r["task"] == "maze" and r["configuration"] in configurations]
    points = [
        {"run": r["run"], "step": 5000.0, "trajectories": 25.0, "entropy": r["entropy"]}
        for r in rows
    ]
    runs = SweepRuns(Tables(as_columns(rows), as_columns(points), {}))
    request = read_request("f", {"groups": ["g"], "draw": kind, **more}, KINDS)
    result = draw(request, runs, scenes(), tmp_path / "f", dpi=100)
    picture = imread(result.files[0])[..., :3]
    above_the_legend = picture[: int(0.85 * len(picture))]
    assert result.missing == ()
    for colour in COLOURS[: len(configurations)]:
        away = np.abs(above_the_legend - np.array(to_rgb(colour))).max(-1)
        assert (away < 0.05).sum() > 10


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        ("exploration", {"metrics": ["entropy"]}),
        ("learning", {"metric": "entropy"}),
        ("convergence", {}),
        ("ablation", {"number": "sigma", "without": 0}),
    ],
)
@pytest.mark.parametrize("name", ["one", "said again"])
def test_a_run_of_two_groups_counts_once(
    tmp_path: Path, make_runs: Make, rows: Rows, kind: str, more: dict[str, Any], name: str
) -> None:
    """Under one name in every figure; under two where it is a point of one series."""
    rows = [{**r, "converged_at": 50 + r["seed"]} for r in rows]
    shared = [{**r, "group": "h", "configuration": name} for r in rows[:2]]
    _, alone = drawn(tmp_path, make_runs(rows), draw=kind, **more)
    _, both = drawn(tmp_path, make_runs([*rows, *shared]), draw=kind, groups=["g", "h"], **more)
    assert [r for r in both if r.get("configuration") != "said again"] == alone


def test_learning_holds_the_last_value_of_ended_runs_alone(
    tmp_path: Path, make_runs: Make, rows: Rows
) -> None:
    """While a sweep is under way: a run that has just begun says nothing of later trajectories."""
    rows = [r for r in rows if r["task"] == "maze" and r["configuration"] == "one"]

    def last_row(state: str) -> dict[str, str]:
        rows[0]["state"] = state
        runs = make_runs(rows)
        table_of_first = runs.of(["g"])[0].table
        for name, column in table_of_first.items():
            table_of_first[name] = column[:1]
        _, table = drawn(tmp_path, runs, draw="learning", metric="entropy")
        return table[-1]

    ended, begun = last_row("done"), last_row("begun")
    assert (ended["runs"], begun["runs"]) == ("3", "2")
    assert float(ended["mean"]) == pytest.approx((2.5 + 11 + 12) / 3)
    assert float(begun["mean"]) == pytest.approx((11 + 12) / 2)


def test_learning_is_a_panel_per_target(tmp_path: Path, make_runs: Make, rows: Rows) -> None:
    rows = [{**r, "target": t, "run": f"{r['run']}-{t}"} for r in rows for t in ("t1", "t2")]
    _, table = drawn(tmp_path, make_runs(rows), draw="learning", metric="entropy", x="step")
    assert {(r["task"], r["target"]) for r in table} == {
        (task, target) for task in ("maze", "door") for target in ("t1", "t2")
    }
    assert max(float(r["step"]) for r in table) == 20_000


def test_ablation_compares_ends_with_what_was_published(
    tmp_path: Path, make_runs: Make, rows: Rows
) -> None:
    rows[-1]["state"] = "begun"
    result, table = drawn(
        tmp_path, make_runs(rows), draw="ablation", number="sigma", without=0,
        paper={0: 40.2, 2: 51.4, 3: 51.4},
    )  # fmt: skip
    found = {float(r["sigma"]): r for r in table}
    assert sorted(found) == [0, 2, 3]
    assert float(found[0]["mean"]) == pytest.approx(11.0)
    assert (found[0]["runs"], found[2]["runs"], found[3]["runs"]) == ("6", "5", "0")
    assert found[3]["mean"] == ""
    assert float(found[2]["paper"]) == 51.4
    assert result.missing == ("g/two, door: of 3 runs 1 have not ended",)


def test_convergence_counts_those_that_have_and_says_how_long_the_others_tried(
    tmp_path: Path, make_runs: Make, rows: Rows
) -> None:
    rows[0]["converged_at"], rows[1]["converged_at"] = 50, 70
    rows[3]["state"] = "waiting"
    paper = {"maze": {"one": {"default": 349}, "two": "not below 3000"}}
    result, table = drawn(tmp_path, make_runs(rows), draw="convergence", paper=paper)
    found = {(r["task"], r["configuration"]): r for r in table}
    one, two = found["maze", "one"], found["maze", "two"]
    assert (one["runs"], one["converged"], float(one["mean"]), one["paper"]) == (
        "3", "2", 60.0, "349",
    )  # fmt: skip
    assert one["each"] == "0:50 1:70 2:"
    assert (two["runs"], two["converged"], two["mean"], two["longest"]) == ("2", "0", "", "100")
    assert two["paper"] == "not below 3000"
    assert found["door", "one"]["paper"] == ""
    assert result.missing == ("g/two, maze: of 3 runs 1 have not begun",)


def test_visits_show_what_was_seen_by_then(tmp_path: Path, make_runs: Make, rows: Rows) -> None:
    rows = [r for r in rows if r["task"] == "maze"]
    result, table = drawn(tmp_path, make_runs(rows), draw="visits", refreshes=[1, 4, 80])
    assert [int(r["trajectories"]) for r in table] == [25, 100, 100]
    assert [r["reached"] for r in table] == ["true", "true", "false"]
    assert float(table[0]["covered_cells"]) == pytest.approx(0.2)
    assert "two on maze: no run has kept its states" in result.missing


def test_states_that_a_run_no_longer_holds_are_missing(
    tmp_path: Path, make_runs: Make, rows: Rows
) -> None:
    rows = [r for r in rows if r["task"] == "maze"]
    runs = make_runs(rows)
    runs.states["trajectory"] = [number + 30 for number in runs.states["trajectory"]]
    result, table = drawn(tmp_path, runs, draw="visits", refreshes=[1, 4])
    assert [int(r["trajectories"]) for r in table] == [0, 100]
    assert "one on maze: no states of the first 30 trajectories are held" in result.missing


def test_targets_are_where_the_task_has_them(tmp_path: Path, make_runs: Make, rows: Rows) -> None:
    rows = [r for r in rows if r["task"] == "maze"]
    _, table = drawn(tmp_path, make_runs(rows), draw="targets")
    found = {r["target"]: (float(r["x"]), float(r["y"])) for r in table}
    assert set(found) == set(tasks.find("point_maze").targets)
    assert (-4.0, 0.0) in found.values()


@pytest.mark.parametrize("kind", ["exploration", "learning", "ablation", "convergence", "visits"])
def test_nothing_is_drawn_of_nothing(
    tmp_path: Path, make_runs: Make, rows: Rows, kind: str
) -> None:
    for r in rows:
        r |= {"state": "waiting", "task": "maze", "entropy": None}
    runs = make_runs(rows)
    runs.states = {}
    more = {"number": "sigma", "without": 0} if kind == "ablation" else {}
    result, _ = drawn(tmp_path, runs, draw=kind, **more)
    assert not result.files
    assert any("have not begun" in line or "kept" in line for line in result.missing)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (3, "a mapping is needed"),
        ({"draw": "pie"}, "draw is 'pie'; allowed: exploration"),
        ({"draw": "ablation"}, "groups is None"),
        ({"draw": "ablation", "groups": ["g"], "sigma": 1}, "unknown sigma; a figure ablation has"),
        ({"draw": "ablation", "groups": ["g"], "paper": [1]}, "paper is"),
    ],
)
def test_a_figure_that_is_none_is_refused(content: object, says: str) -> None:
    with pytest.raises(ConfigurationError) as error:
        read_request("f", content, KINDS)
    assert "figure f" in str(error.value)
    assert says in str(error.value)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"draw": "ablation", "number": "sigma"}, "`without` says"),
        ({"draw": "visits", "refreshes": [0]}, "natural numbers"),
        ({"draw": "visits", "configurations": ["three"]}, "there are one, two"),
        ({"draw": "exploration", "metrics": "entropy"}, "a list is needed"),
    ],
)
def test_a_figure_that_does_not_fit_the_results_is_refused(
    tmp_path: Path, make_runs: Make, rows: Rows, content: dict[str, Any], says: str
) -> None:
    with pytest.raises(ConfigurationError, match=says):
        drawn(tmp_path, make_runs(rows), **content)
