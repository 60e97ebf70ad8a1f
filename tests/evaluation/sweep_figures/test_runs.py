"""Means and deviations of runs, by hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.evaluation.sweep_figures.runs import Curve, SweepRuns, band, missing, spread


def line(*points: tuple[float, float]) -> Curve:
    x, y = np.array(points).T
    return Curve(x, y)


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


def test_empty_cells_are_no_points(make_runs: Callable[..., SweepRuns], rows: Any) -> None:
    runs = make_runs(rows)
    (entry,) = runs.of(["g"], configuration="two", task="door", seed=1)
    entry.table["entropy"][1] = np.nan
    curve = entry.curve("trajectories", "entropy")
    assert curve is not None
    assert curve.x.tolist() == [25, 75, 100]
    assert entry.curve("trajectories", "no such column") is None
