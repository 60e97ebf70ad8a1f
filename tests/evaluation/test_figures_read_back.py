"""Pictures of a run show what its files say: read back from what is drawn."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import pyplot

from skewmi.cli.main import main
from skewmi.evaluation import drawing
from skewmi.train.history import visited_states

TARGET = (-4.36, 1.42)
"""Of name t3, m."""
RADIUS = 0.15


@pytest.fixture(scope="module", params=["rewarded", "unrewarded"])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run in the maze."""
    run_dir = tmp_path_factory.mktemp("runs") / "run"
    arguments = ["train", "--task", "point_maze", "--run-dir", str(run_dir), "--quiet"]
    arguments += ["--option", 'target="t3"', *["--unrewarded"][request.param == "rewarded" :]]
    assert main([*arguments, "--steps", "1600", "--num-envs", "3"]) == 0
    return run_dir


@pytest.fixture
def drawn(run: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[dict[str, Any]]:
    """See `figures_of`."""
    yield figures_of(run, tmp_path, monkeypatch)
    pyplot.close("all")


def figures_of(run: Path, out: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Figures by the name of their file, before they are made into pixels."""
    figures: dict[str, Any] = {}
    monkeypatch.setattr(
        drawing, "save", lambda figure, path, dpi: figures.update({Path(path).name: figure})
    )
    assert main(["figures", str(run), "--out", str(out)]) == 0
    return figures


def column(run: Path, name: str) -> np.ndarray:
    """Of the table, without a reader of ours; NaN where it says nothing."""
    with (run / "metrics.csv").open() as file:
        return np.array([float(row[name] or "nan") for row in csv.DictReader(file)])


def test_curves_are_the_columns_that_their_titles_name(run: Path, drawn: dict[str, Any]) -> None:
    axes = {axis.get_title(): axis for axis in drawn["curves.png"].axes if axis.get_title()}
    for title, names in {
        "entropy (as published: no cell area)": ["entropy"],
        "differential entropy, nats": ["differential_entropy"],
        "coverage": ["covered_cells", "coverage"],
        "rewarded share": ["rewarded_fraction", "evaluation_fraction"],
        "extrinsic return": ["return", "evaluation_return"],
        "policy entropy, nats": ["policy_entropy"],
    }.items():
        for line, name in zip(axes[title].get_lines(), names, strict=False):
            expected, trajectories = column(run, name), column(run, "trajectories")
            known = np.isfinite(expected)
            np.testing.assert_allclose(line.get_xdata(), trajectories[known], err_msg=name)
            np.testing.assert_allclose(line.get_ydata(), expected[known], err_msg=name)
    assert f"{column(run, 'step')[-1]:,.0f} environment steps" in title_of(drawn["curves.png"])


def test_learning_is_the_evaluations_of_the_table(run: Path, drawn: dict[str, Any]) -> None:
    figure = drawn["learning.png"]
    share = column(run, "evaluation_fraction")
    known = np.isfinite(share)
    curves = [line for line in figure.axes[0].get_lines() if line.get_label().startswith("seed")]
    for line in curves:
        np.testing.assert_allclose(line.get_xdata(), column(run, "trajectories")[known])
        np.testing.assert_allclose(line.get_ydata(), 100.0 * share[known])
    assert len(curves) == 1
    # The title promises states that were visited only where a plane of them is drawn.
    promised = "visited states" in title_of(figure)
    assert promised == (len(figure.axes) > 2)


def test_points_of_the_coverage_are_states_that_were_visited(
    run: Path, drawn: dict[str, Any]
) -> None:
    figure = drawn["coverage.png"]
    states, _ = visited_states(run)
    axis = figure.axes[0]
    (points,) = [c for c in axis.collections if len(c.get_offsets()) == states[..., 0].size]
    np.testing.assert_allclose(points.get_offsets(), states.reshape(-1, states.shape[-1])[:, :2])
    np.testing.assert_array_equal(
        points.get_array(), np.repeat(np.arange(len(states)) + 1, states.shape[1])
    )
    title = title_of(figure)
    assert f"visited in {len(states):,} trajectories" in title
    # The outline that is promised is the target's, and is called what it is to this run.
    outlines = [c for c in axis.collections if type(c).__name__ == "QuadContourSet"]
    corners = [path.vertices for outline in outlines for path in outline.get_paths()]
    around = [c for c in corners if len(c) and np.abs(c.mean(0) - TARGET).max() < 0.1]
    assert len(around) == 1
    np.testing.assert_allclose(np.linalg.norm(around[0] - TARGET, axis=1), RADIUS, atol=0.03)
    rewarded = json.loads((run / "config.json").read_text())["config"]["rewarded"]
    assert title.endswith(
        "; rewarded states lie inside orange"
        if rewarded
        else "; states of the target, not rewarded here, lie inside orange"
    )


def test_where_the_last_states_alone_are_held_pictures_say_so(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run whose history has room for 5 of its 9 trajectories."""
    wrapped = tmp_path / "wrapped"
    shutil.copytree(run, wrapped)
    header = json.loads((run / "config.json").read_text())
    header["config"]["rollout"]["history_steps"] = 5 * header["layout"]["episode_steps"]
    (wrapped / "config.json").write_text(json.dumps(header))
    states, _ = visited_states(run)
    figures = figures_of(wrapped, tmp_path, monkeypatch)
    axis = figures["coverage.png"].axes[0]
    flat = states[-5:].reshape(-1, states.shape[-1])
    (points,) = [c for c in axis.collections if len(c.get_offsets()) == len(flat)]
    np.testing.assert_allclose(points.get_offsets(), flat[:, :2])
    made = len(states)
    assert made > 5
    numbers = np.repeat(np.arange(made - 5, made) + 1, states.shape[1])
    np.testing.assert_array_equal(points.get_array(), numbers)
    assert f"visited in the last 5 of {made} trajectories" in title_of(figures["coverage.png"])
    assert "in its last 5 trajectories" in title_of(figures["learning.png"])
    pyplot.close("all")


def title_of(figure: Any) -> str:
    """Its words, over however many lines."""
    return str(figure.get_suptitle()).replace("\n", " ")
