"""Means and deviations of runs, by hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.evaluation.sweep_figures.runs import Curve, SweepRuns, band, missing, spread


def line(*points: tuple[float, float], ended: bool = True) -> Curve:
    x, y = np.array(points).T
    return Curve(x, y, ended)


def test_a_band_is_mean_and_deviation_at_every_point_of_any() -> None:
    shown = band([line((0, 0), (2, 4)), line((0, 2), (1, 2), (2, 2))])
    np.testing.assert_allclose(shown.x, [0, 1, 2])
    np.testing.assert_allclose(shown.mean, [1, 2, 3])
    np.testing.assert_allclose(shown.deviation, [np.sqrt(2), 0, np.sqrt(2)])
    assert shown.runs.tolist() == [2, 2, 2]


def test_a_run_counts_as_far_as_it_goes_unless_its_last_value_is_held() -> None:
    curves = [line((0, 0), (1, 1)), line((0, 0), (2, 4))]
    far = band(curves)
    np.testing.assert_allclose(far.mean, [0, 1.5, 4])
    assert far.runs.tolist() == [2, 2, 1]
    assert far.deviation[-1] == 0.0
    np.testing.assert_allclose(band(curves, hold=True).mean, [0, 1.5, 2.5])


def test_only_of_a_run_that_has_ended_the_last_value_is_held() -> None:
    ended, begun = line((0, 0), (1, 1)), line((0, 0), (1, 1), ended=False)
    far = line((0, 0), (2, 4))
    np.testing.assert_allclose(band([ended, begun, far], hold=True).runs, [3, 3, 2])
    np.testing.assert_allclose(band([ended, begun, far], hold=True).mean, [0, 4 / 3, 2.5])
    # What a run has measured counts the same, whether it has ended or not.
    held, left = band([begun, far], hold=True), band([begun, far])
    np.testing.assert_allclose(held.mean, left.mean)


def test_a_curve_knows_whether_its_run_has_ended(
    make_runs: Callable[..., SweepRuns], rows: list[dict[str, Any]]
) -> None:
    rows[1]["state"] = "begun"
    runs = make_runs(rows)
    curves = [entry.curve("trajectories", "entropy") for entry in runs.of(["g"])]
    assert [curve.ended for curve in curves if curve is not None] == [
        r["state"] == "done" for r in rows
    ]


def test_nothing_is_said_of_what_is_before_the_first_measurement() -> None:
    shown = band([line((1, 1), (2, 2)), line((0, 0), (2, 2))], hold=True)
    assert shown.runs.tolist() == [1, 2, 2]


def test_many_points_become_a_grid() -> None:
    shown = band([line(*((k, 2.0 * k) for k in range(1000)))], points=50)
    assert len(shown.x) == 50
    np.testing.assert_allclose(shown.mean, 2.0 * shown.x)


def test_spread_of_one_value_and_of_none() -> None:
    assert spread([3.0]) == (3.0, 0.0)
    assert spread([1.0, 3.0]) == (2.0, pytest.approx(np.sqrt(2)))
    with pytest.raises(ConfigurationError):
        spread([])


def test_what_is_missing_is_told(
    make_runs: Callable[..., SweepRuns], rows: list[dict[str, Any]]
) -> None:
    rows[0]["state"], rows[1]["state"] = "waiting", "begun"
    rows[2]["target"] = "t1"
    runs = make_runs(rows)
    assert missing(runs.of(["g"])) == ["g/one, maze: of 2 runs 1 have not begun, 1 have not ended"]
    with pytest.raises(NotFoundError, match="groups are g"):
        runs.of(["h"])


def test_a_run_that_groups_share_is_there_once_per_configuration(
    make_runs: Callable[..., SweepRuns], rows: list[dict[str, Any]]
) -> None:
    again = [{**r, "group": "h"} for r in rows[:2]]
    renamed = [{**rows[0], "group": "h", "configuration": "said again"}]
    rows[1]["state"] = again[1]["state"] = "begun"
    runs = make_runs([*rows, *again, *renamed])

    def found(*groups: str) -> list[tuple[str, str]]:
        return [(e.facts["configuration"], e.name) for e in runs.of(groups)]

    assert found("g") == [(r["configuration"], r["run"]) for r in rows]
    assert found("h") == [(r["configuration"], r["run"]) for r in (*again, *renamed)]
    assert found("g", "h") == [*found("g"), ("said again", rows[0]["run"])]
    assert missing(runs.of(["g", "h"])) == ["g/one, maze: of 3 runs 1 have not ended"]


def test_empty_cells_are_no_points(make_runs: Callable[..., SweepRuns], rows: Any) -> None:
    runs = make_runs(rows)
    (entry,) = runs.of(["g"], configuration="two", task="door", seed=1)
    entry.table["entropy"][1] = np.nan
    curve = entry.curve("trajectories", "entropy")
    assert curve is not None
    assert curve.x.tolist() == [25, 75, 100]
    assert entry.curve("trajectories", "no such column") is None
