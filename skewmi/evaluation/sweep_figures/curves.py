"""Bands of measurements over trajectories: how configurations explore, and how they learn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skewmi.errors import ConfigurationError
from skewmi.evaluation import drawing
from skewmi.evaluation.sweep_figures.figure import COLOURS, Drawn, Request, write_figure
from skewmi.evaluation.sweep_figures.runs import Curve, Entry, SweepRuns, band, distinct, missing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

EXPLORATION_KEYS = ("metrics",)
LEARNING_KEYS = ("metric",)
WORDS = {
    "entropy": "entropy (as published)",
    "coverage": "coverage (as published)",
    "covered_cells": "visited share of reachable cells",
    "differential_entropy": "differential entropy [nats]",
    "evaluation_fraction": "last 10 states rewarded, last 10 trajectories",
    "evaluation_return": "return of an episode, evaluation",
    "return": "return of an episode",
    "rewarded_fraction": "episodes with a reward",
    "step": "environment steps",
    "refresh": "refreshes of the goals",
}
"""Columns in words, where their names are not."""
_LEGEND_WIDTH = 2.4
"""Of an entry of the legend, inches."""


def draw_exploration(request: Request, runs: SweepRuns, stem: Path, dpi: int) -> Drawn:
    """A row of panels per metric, a column per task, a band per configuration.

    Published values, `paper: {TASK: {CONFIGURATION: {METRIC: value}}}`, are dashed lines.
    """
    entries = runs.of(request.groups)
    metrics = request.more.get("metrics", ["coverage", "entropy"])
    if not isinstance(metrics, list) or not all(isinstance(m, str) for m in metrics):
        raise ConfigurationError(f"figure {request.name}: metrics is {metrics!r}; a list is needed")
    tasks, colours = distinct(entries, "task"), colours_of(entries)
    figure, axes = drawing.new_axes(
        len(metrics), len(tasks), 5.2 * len(tasks), 3.2 * len(metrics) + 0.6
    )
    rows: list[dict[str, Any]] = []
    for column, task in enumerate(tasks):
        of_task = [entry for entry in entries if entry.facts["task"] == task]
        for row, metric in enumerate(metrics):
            axis = axes[row, column]
            found = _draw_bands(axis, request, of_task, metric, colours, hold=False)
            rows += [{"task": task, "metric": metric, **one} for one in found]
            _draw_published(axis, request, task, metric, colours)
            axis.set_ylabel(WORDS.get(metric, metric))
        axes[0, column].set_title(str(task).replace("_", " "))
    return _finish(figure, request, axes, rows, entries, stem, dpi)


def draw_learning(request: Request, runs: SweepRuns, stem: Path, dpi: int) -> Drawn:
    """A panel per task and target, a band per configuration; ended runs keep their last value.

    Published trajectories to convergence, `paper: {TASK: {CONFIGURATION: {TARGET: number}}}`, are
    dotted lines.
    """
    entries = runs.of(request.groups)
    metric = str(request.more.get("metric", "evaluation_fraction"))
    panels = list(dict.fromkeys((e.facts["task"], e.facts.get("target")) for e in entries))
    columns, colours = min(len(panels), 3), colours_of(entries)
    lines = -(-len(panels) // columns)
    figure, axes = drawing.new_axes(lines, columns, 4.8 * max(columns, 1) + 1.0, 3.0 * lines + 0.6)
    rows: list[dict[str, Any]] = []
    for axis, (task, target) in zip(axes.ravel(), panels, strict=False):
        mine = [e for e in entries if (e.facts["task"], e.facts.get("target")) == (task, target)]
        found = _draw_bands(axis, request, mine, metric, colours, hold=True)
        rows += [{"task": task, "target": target, "metric": metric, **one} for one in found]
        for name, colour in colours.items():
            value = request.paper.get(task, {}).get(name, {}).get(target or "default")
            if isinstance(value, int | float):
                axis.axvline(value, color=colour, linestyle=":", linewidth=1.2)
        words = f", target {target}" if target else ""
        axis.set_title(f"{str(task).replace('_', ' ')}{words}", fontsize=10)
        axis.set_ylabel(WORDS.get(metric, metric), fontsize=8)
    for axis in axes.ravel()[len(panels) :]:
        axis.set_axis_off()
    return _finish(figure, request, axes, rows, entries, stem, dpi)


def _draw_bands(
    axis: Axes,
    request: Request,
    entries: Sequence[Entry],
    metric: str,
    colours: Mapping[str, str],
    *,
    hold: bool,
) -> list[dict[str, Any]]:
    """A band per configuration, and what was drawn as rows."""
    rows: list[dict[str, Any]] = []
    for name in distinct(entries, "configuration"):
        curves = curves_of(
            [e for e in entries if e.facts["configuration"] == name], request, metric
        )
        if not curves:
            continue
        colour = colours[name]
        shown = band(curves, hold=hold)
        # A line through a single measurement would be nothing to see.
        marker = "o" if len(shown.x) == 1 else ""
        label = f"{name} ({len(curves)})"
        axis.plot(shown.x, shown.mean, color=colour, marker=marker, markersize=5, label=label)
        low, high = shown.mean - shown.deviation, shown.mean + shown.deviation
        axis.fill_between(shown.x, low, high, color=colour, alpha=0.18, linewidth=0)
        rows += [
            {"configuration": name, request.x: x, "mean": m, "deviation": d, "runs": int(n)}
            for x, m, d, n in zip(
                shown.x.tolist(), shown.mean.tolist(), shown.deviation.tolist(),
                shown.runs.tolist(), strict=True,
            )
        ]  # fmt: skip
    if not rows:
        axis.text(0.5, 0.5, "no runs yet", ha="center", va="center", transform=axis.transAxes,
                  color=drawing.GREY)  # fmt: skip
    axis.set_xlabel(WORDS.get(request.x, request.x))
    return rows


def colours_of(entries: Sequence[Entry]) -> dict[str, str]:
    """A colour per configuration, the same in every panel."""
    names = distinct(entries, "configuration")
    return {name: COLOURS[k % len(COLOURS)] for k, name in enumerate(names)}


def curves_of(entries: Sequence[Entry], request: Request, metric: str) -> list[Curve]:
    """The curves of those runs that have one."""
    found = (entry.curve(request.x, metric) for entry in entries)
    return [curve for curve in found if curve is not None]


def _draw_published(
    axis: Axes, request: Request, task: str, metric: str, colours: Mapping[str, str]
) -> None:
    values: Mapping[str, Any] = request.paper.get(task, {})
    for name, by_metric in values.items():
        if isinstance(by_metric, dict) and metric in by_metric:
            colour = colours.get(name, drawing.GREY)
            axis.axhline(by_metric[metric], color=colour, linestyle="--", linewidth=1.0)
            axis.text(
                0.01, by_metric[metric], f" paper {by_metric[metric]:g}", fontsize=7,
                va="bottom", transform=axis.get_yaxis_transform(),
            )  # fmt: skip


def _finish(
    figure: Any,
    request: Request,
    axes: Any,
    rows: Sequence[Mapping[str, Any]],
    entries: Sequence[Entry],
    stem: Path,
    dpi: int,
) -> Drawn:
    """The legend beside all panels, once, and the files."""
    lacking = tuple(missing(entries))
    if not rows:
        from matplotlib import pyplot

        pyplot.close(figure)
        return Drawn((), lacking or ("nothing of it has been measured",))
    handles: dict[str, Any] = {}
    for axis in axes.ravel():
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            # The number of runs may differ between panels; the CSV has each.
            handles.setdefault(label.rpartition(" (")[0], handle)
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", frameon=False, fontsize=8,
        ncols=max(int(figure.get_figwidth() // _LEGEND_WIDTH), 1),
    )  # fmt: skip
    drawing.set_title(figure, f"{request.title}: mean and deviation", 11)
    return Drawn(write_figure(figure, rows, stem, dpi), lacking)
