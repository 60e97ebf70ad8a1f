"""How runs of one task learned: their records, and one picture of them side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skewmi.errors import CheckpointError
from skewmi.evaluation import drawing
from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.checkpoint import read_checkpoint, read_run_header
from skewmi.train.config import TrainConfig
from skewmi.train.log import read_metrics
from skewmi.train.milestones import REWARD_EVENT
from skewmi.train.visited import visited_trajectories

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SEED_COLOURS = ("#4c9ac2", "#e0a13c", "#7fb069", "#b079b8", "#d1655d", "#8c8c8c")
_DISPLAY = {"rad": ("deg", 180.0 / math.pi), "m": ("mm", 1e3)}
"""Units people read: by unit of a field its name and how many make one of the field's."""


@dataclass(frozen=True)
class RunRecord:
    """What a run directory says about its learning, up to its latest checkpoint.

    Attributes:
        run_dir: Where it is.
        config, layout: Of the run.
        table: Columns of metrics.csv.
        state: Of the latest checkpoint.
    """

    run_dir: Path
    config: TrainConfig
    layout: PolicyLayout
    table: dict[str, list[float]]
    state: dict[str, Any]

    @property
    def trajectories(self) -> int:
        """Finished in all."""
        return int(self.state["episodes"])

    @property
    def converged_at(self) -> int | None:
        """Trajectories after which our criterion of convergence held first, or None."""
        value = self.state["converged_at"]
        return None if value is None else int(value)

    @property
    def converged_at_paper(self) -> int | None:
        """Trajectories after which the published criterion held first, or None."""
        value = self.state.get("converged_at_paper")
        return None if value is None else int(value)

    @property
    def discoveries(self) -> dict[str, dict[str, int] | None]:
        """First trajectory and step of every event the run looked for, None if never met."""
        found = self.state["discoveries"]
        names = (*(event.name for event in self.config.task_metrics.events), REWARD_EVENT)
        return {name: found.get(name) for name in names}

    @property
    def goes_on(self) -> bool:
        """Whether more is to come. Where `minutes` may have ended the run nothing says if they did,
        and it counts as ended."""
        config = self.config
        converged = config.stop_on_convergence and self.converged_at is not None
        steps_left = int(self.state["step"]) < config.total_steps
        return steps_left and not converged and config.minutes is None

    @property
    def curve(self) -> tuple[Array, Array]:
        """Trajectories, and the evaluations' rewarded share of last states, equal shapes."""
        x, y = np.array(self.table["trajectories"]), np.array(self.table["evaluation_fraction"])
        known = np.isfinite(y)
        return x[known], y[known]

    @property
    def seconds(self) -> float:
        """Wall-clock seconds of the run."""
        return self.table["seconds"][-1]

    def seconds_at(self, trajectories: int) -> float | None:
        """Wall-clock seconds until so many trajectories, None if there were never as many."""
        table = zip(self.table["trajectories"], self.table["seconds"], strict=True)
        return next((seconds for count, seconds in table if count >= trajectories), None)


def read_table(run_dir: Path) -> dict[str, list[float]]:
    """Columns of a run's metrics.csv, at least one row.

    Raises:
        CheckpointError: The table is missing, damaged or empty.
    """
    try:
        table = read_metrics(run_dir)
    except (OSError, ValueError) as error:
        raise CheckpointError(f"{run_dir} has no readable metrics.csv: {error}") from error
    if not table:
        raise CheckpointError(f"{run_dir / 'metrics.csv'} has no rows yet; train first")
    return table


def read_record(run_dir: Path) -> RunRecord:
    """Read a run.

    Raises:
        CheckpointError: There is no such run or checkpoint, or it is damaged.
    """
    config, layout = read_run_header(run_dir)
    table = read_table(run_dir)
    return RunRecord(run_dir, config, layout, table, read_checkpoint(run_dir).state)


def median_curve(records: Sequence[RunRecord]) -> tuple[Array, Array]:
    """Median over runs at every trajectory count of any.

    A run that has ended keeps its last value; one that goes on counts as far as it is.
    """
    grid = np.unique(np.concatenate([record.curve[0] for record in records]))
    held = []
    for record in records:
        x, y = record.curve
        values = y[np.maximum(np.searchsorted(x, grid, side="right") - 1, 0)]
        held.append(np.where(record.goes_on & (grid > x[-1]), np.nan, values))
    return grid, np.nanmedian(held, axis=0)


def draw_learning(
    records: Sequence[RunRecord], path: Path, dpi: int, planes: Sequence[tuple[str, str]] = ()
) -> Path:
    """Learning curves and discoveries of runs of one task, and what one of them visited.

    That one is the first that converged, or else the first.

    Args:
        records: At least one; all of one task.
        path: Picture file to write.
        dpi: Dots per inch.
        planes: Pairs of state fields whose visited states are drawn, beside the hand's.
    """
    first = records[0]
    shown = next((r for r in records if r.converged_at is not None), first)
    shown_planes = _planes(first.layout, planes)
    rows = [*first.discoveries, "convergence"]
    figure = drawing.new_figure(12.0, 5.4 + 4.2 * bool(shown_planes))
    heights = [3.2, 0.32 * len(rows), 4.2][: 3 if shown_planes else 2]
    grid = figure.add_gridspec(len(heights), max(len(shown_planes), 1), height_ratios=heights)
    top = figure.add_subplot(grid[0, :])
    below = figure.add_subplot(grid[1, :], sharex=top)
    _draw_curves(top, records)
    _draw_discoveries(below, records, rows)
    end = max(record.trajectories for record in records)
    top.set_xlim(-0.01 * end, 1.02 * end)
    words = ""
    if shown_planes:
        states, numbers = visited_trajectories(shown.run_dir)
        words = f"; visited states of seed {shown.config.seed}"
        if len(numbers) < numbers[-1]:
            words += f" in its last {len(numbers):,} trajectories"
        flat = states.reshape(-1, states.shape[-1])
        for k, columns in enumerate(shown_planes):
            _draw_visits(figure.add_subplot(grid[2, k]), first.layout, flat, columns)
    for axis in figure.axes:
        drawing.strip(axis)
    converged = sum(record.converged_at is not None for record in records)
    drawing.set_title(
        figure,
        f"{first.config.task}, preset {first.config.preset}: {converged} of {len(records)} "
        f"run{'s' * (len(records) > 1)} converged{words}",
        fontsize=11,
    )
    drawing.save(figure, path, dpi)
    return path


def _colours(count: int) -> list[Any]:
    """One for each run, no two alike."""
    if count <= len(_SEED_COLOURS):
        return list(_SEED_COLOURS[:count])
    from matplotlib import colormaps

    return list(colormaps["turbo"](np.linspace(0.05, 0.95, count)))


def _draw_curves(axis: Axes, records: Sequence[RunRecord]) -> None:
    threshold = records[0].config.metrics.convergence_fraction
    axis.axhline(100.0 * threshold, color=drawing.GREY, linewidth=0.8, linestyle=":")
    axis.text(0.0, 100.0 * threshold + 1.5, " needed to converge", fontsize=7, color=drawing.GREY)
    alone = len(records) == 1
    colours = _colours(len(records))
    for record, colour in zip(records, colours, strict=True):
        x, y = record.curve
        axis.plot(
            x, 100.0 * y, color=colour, linewidth=1.8 if alone else 1.0,
            label=f"seed {record.config.seed}",
        )  # fmt: skip
        axis.plot(x[-1], 100.0 * y[-1], ".", color=colour, markersize=7)
    if not alone:
        x, y = median_curve(records)
        label = "median (ended runs keep their last value)"
        # Below the runs: where all are equal, they stay visible on it.
        axis.plot(x, 100.0 * y, color="0.2", linewidth=3.2, label=label, zorder=1.5)
    axis.set_ylabel("last 10 states rewarded,\nlast 10 evaluations [%]", fontsize=9)
    axis.set_ylim(-2.0, 102.0)
    axis.tick_params(labelbottom=False)
    columns = 1 + len(records) // 7  # or they reach beyond the axes
    axis.legend(frameon=False, fontsize=8, loc="center left", ncols=columns)


def _draw_discoveries(axis: Axes, records: Sequence[RunRecord], rows: Sequence[str]) -> None:
    """A line of ticks per event, one tick per run."""
    for record, colour in zip(records, _colours(len(records)), strict=True):
        met = {name: first["trajectory"] for name, first in record.discoveries.items() if first}
        if record.converged_at is not None:
            met["convergence"] = record.converged_at
        x, y = list(met.values()), [rows.index(name) for name in met]
        axis.plot(x, y, "|", color=colour, markersize=11, markeredgewidth=2.0)
    axis.set_yticks(range(len(rows)), [*(f"first {n}" for n in rows[:-1]), rows[-1]], fontsize=8)
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.grid(axis="y", linewidth=0.4, alpha=0.5)
    axis.set_xlabel("trajectories")


def _planes(layout: PolicyLayout, planes: Sequence[tuple[str, str]]) -> list[tuple[int, int]]:
    """Pairs of state fields worth a map: the task's own, and the hand's vertical plane; of a task
    with two state fields these."""
    names = [field.name for field in layout.state_fields]
    pairs = (*planes, ("hand_y", "hand_z"))
    found = [(names.index(u), names.index(v)) for u, v in pairs if {u, v} <= set(names)]
    return found or ([(0, 1)] if len(names) == 2 else [])


def _draw_visits(axis: Axes, layout: PolicyLayout, states: Array, columns: tuple[int, int]) -> None:
    """How often each cell of a plane was visited, logarithmic."""
    from matplotlib.colors import LogNorm

    labels, scales = [], []
    for column in columns:
        field = layout.state_fields[column]
        unit, scale = _DISPLAY.get(field.unit, (field.unit, 1.0))
        labels.append(f"{field.name.replace('_', ' ')} [{unit}]")
        scales.append(scale)
    x, y = states[:, columns[0]] * scales[0], states[:, columns[1]] * scales[1]
    image = axis.hist2d(x, y, bins=(120, 80), cmap="viridis", norm=LogNorm())[3]
    image.set_rasterized(True)
    if drawing.draw_region(axis, layout, columns, (scales[0], scales[1])):
        title = "rewarded states lie inside orange"
        axis.set_title(title, fontsize=8, color=drawing.ORANGE, loc="left")
    _draw_box(axis, layout, columns, (scales[0], scales[1]))
    axis.use_sticky_edges = False
    axis.margins(0.02)
    axis.autoscale()
    axis.set_xlabel(labels[0])
    axis.set_ylabel(labels[1])
    axis.figure.colorbar(image, ax=axis, label="visits per cell", shrink=0.9)


def _draw_box(
    axis: Axes, layout: PolicyLayout, columns: tuple[int, int], scale: tuple[float, float]
) -> None:
    """Outline of the box that the hand's commands are clipped to, in a plane of the hand."""
    hand = [f"hand_{direction}" for direction in "xyz"]
    names = [layout.state_fields[column].name for column in columns]
    if layout.workspace is None or not set(names) <= set(hand):
        return
    sides = [hand.index(name) for name in names]
    low, high = np.array(layout.workspace.low)[sides], np.array(layout.workspace.high)[sides]
    corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]], low]) * scale
    axis.plot(*corners.T, color="black", linestyle="--", linewidth=1.0)
    axis.set_title("dashed: box of the commands", fontsize=8, loc="left")
