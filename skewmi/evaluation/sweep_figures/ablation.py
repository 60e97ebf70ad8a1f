"""A measurement at the end of runs over one number of theirs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from skewmi.errors import ConfigurationError
from skewmi.evaluation import drawing
from skewmi.evaluation.sweep_figures.curves import WORDS
from skewmi.evaluation.sweep_figures.figure import COLOURS, Drawn, Request, write_figure
from skewmi.evaluation.sweep_figures.runs import Entry, SweepRuns, each_once, missing, spread

KEYS = ("number", "without", "metric")


def draw_ablation(request: Request, runs: SweepRuns, stem: Path, dpi: int) -> Drawn:
    """Mean, deviation and each run of `metric` over `number`, a column of the results.

    Runs without that number, as those of the limit where it is none, count as `without`.
    Published values, `paper: {number: value}`, stand beside.
    """
    number = str(request.more.get("number", ""))
    metric = str(request.more.get("metric", "entropy"))
    # All configurations make one series: a run that two of them share is one of its points.
    entries = each_once(runs.of(request.groups))
    values: dict[float, list[float]] = {}
    for entry in entries:
        at, value = _at(entry, number, request), entry.facts.get(metric)
        # Half a run says nothing of how it ends.
        if entry.facts.get("state") == "done" and isinstance(value, int | float):
            values.setdefault(at, []).append(float(value))
        else:
            values.setdefault(at, [])
    paper = {float(at): float(value) for at, value in request.paper.items()}
    rows: list[dict[str, Any]] = []
    for at in sorted({*values, *paper}):
        mean, deviation = spread(values[at]) if values.get(at) else (None, None)
        rows.append(
            {number: at, "mean": mean, "deviation": deviation, "runs": len(values.get(at, [])),
             "paper": paper.get(at)}
        )  # fmt: skip
    lacking = missing(entries)
    if not any(row["runs"] for row in rows):
        return Drawn((), (*lacking, "no run has ended"))
    figure, axes = drawing.new_axes(1, 1, 6.4, 4.2)
    axis = axes[0, 0]
    for at, found in values.items():
        axis.plot([at] * len(found), found, ".", color=COLOURS[0], alpha=0.5)
    known = [row for row in rows if row["runs"]]
    axis.errorbar(
        [row[number] for row in known], [row["mean"] for row in known],
        yerr=[row["deviation"] for row in known], color=COLOURS[0], marker="o", capsize=3,
        label="ours: mean, deviation, each run",
    )  # fmt: skip
    if paper:
        axis.plot(
            sorted(paper), [paper[at] for at in sorted(paper)], "D--", color=COLOURS[1],
            label="paper",
        )  # fmt: skip
    axis.set_xlabel(number)
    axis.set_ylabel(WORDS.get(metric, metric))
    axis.legend(frameon=False, fontsize=8)
    drawing.set_title(figure, request.title, 11)
    return Drawn(write_figure(figure, rows, stem, dpi), tuple(lacking))


def _at(entry: Entry, number: str, request: Request) -> float:
    value = entry.facts.get(number)
    if value is None:
        value = request.more.get("without")
    if not isinstance(value, int | float):
        raise ConfigurationError(
            f"figure {request.name}: run {entry.name} has no {number!r}; number must be a column "
            "of the results, and `without` says what runs count as that have none"
        )
    return float(value)
