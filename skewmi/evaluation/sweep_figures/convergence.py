"""Trajectories to convergence, per target and configuration, as a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from skewmi.evaluation import drawing
from skewmi.evaluation.sweep_figures.figure import Drawn, Request, write_figure
from skewmi.evaluation.sweep_figures.runs import Entry, SweepRuns, distinct, missing, spread

KEYS = ("metric",)


def draw_convergence(request: Request, runs: SweepRuns, stem: Path, dpi: int) -> Drawn:
    """A row per task and configuration, a column per target: ours, and the published value below.

    Of ours the mean and deviation over those runs that converged, and how many of all these are;
    published: `paper: {TASK: {CONFIGURATION: {TARGET: number or text}}}`.
    """
    metric = str(request.more.get("metric", "converged_at"))
    entries = runs.of(request.groups)
    rows = _rows(entries, request, metric)
    lacking = missing(entries)
    if not any(row["runs"] for row in rows):
        return Drawn((), (*lacking, "no run has begun"))
    targets = list(dict.fromkeys(row["target"] for row in rows))
    lines = list(dict.fromkeys((row["task"], row["configuration"]) for row in rows))
    cells = [["", "", *targets]]
    for task, configuration in lines:
        mine = {
            r["target"]: r for r in rows if (r["task"], r["configuration"]) == (task, configuration)
        }
        cells.append(
            [task.replace("_", " "), f"{configuration}", *(_cell(mine.get(t)) for t in targets)]
        )
    figure, axes = drawing.new_axes(1, 1, 3.9 + 1.75 * len(targets), 0.9 + 0.62 * len(lines))
    _draw_cells(axes[0, 0], cells)
    drawing.set_title(
        figure,
        f"{request.title}\ntrajectories to convergence: mean ± deviation (converged of runs); "
        "paper's in brackets",
        fontsize=10,
    )
    return Drawn(write_figure(figure, rows, stem, dpi), tuple(lacking))


def _rows(entries: Sequence[Entry], request: Request, metric: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for task in distinct(entries, "task"):
        for configuration in distinct(entries, "configuration"):
            mine = [
                e for e in entries
                if e.facts["task"] == task and e.facts["configuration"] == configuration
            ]  # fmt: skip
            published = request.paper.get(task, {}).get(configuration, {})
            for target in distinct(mine, "target"):
                name = target or "default"
                of_target = [e for e in mine if e.facts.get("target") == target]
                row = _summary(of_target, metric)
                paper = published.get(name) if isinstance(published, dict) else published
                rows.append(
                    {"task": task, "configuration": configuration, "target": name, **row,
                     "paper": None if paper is None else str(paper)}
                )  # fmt: skip
    return rows


def _summary(entries: Sequence[Entry], metric: str) -> dict[str, Any]:
    """Of runs of one target: those that have not begun do not count."""
    begun = [e for e in entries if e.facts.get("state") != "waiting"]
    found = [float(e.facts[metric]) for e in begun if e.facts.get(metric) is not None]
    mean, deviation = spread(found) if found else (None, None)
    return {
        "runs": len(begun),
        "ended": sum(e.facts.get("state") == "done" for e in begun),
        "converged": len(found),
        "mean": mean,
        "deviation": deviation,
        # Those that have not converged have at least tried as long.
        "longest": max((int(e.facts.get("trajectories") or 0) for e in begun), default=0),
        "each": " ".join(
            f"{e.facts['seed']}:{'' if e.facts.get(metric) is None else int(e.facts[metric])}"
            for e in begun
        ),
    }


def _cell(row: dict[str, Any] | None) -> str:
    if row is None:
        return ""
    paper = f"\n[{row['paper']}]" if row["paper"] is not None else ""
    if not row["runs"]:
        return f"no runs yet{paper}"
    if not row["converged"]:
        return f"none in {row['longest']:,} (0/{row['runs']}){paper}"
    return f"{row['mean']:,.0f} ± {row['deviation']:,.0f} ({row['converged']}/{row['runs']}){paper}"


def _draw_cells(axis: Any, cells: Sequence[Sequence[str]]) -> None:
    axis.set_axis_off()
    widths = [0.7, 1.5] + [1.1] * (len(cells[0]) - 2)
    table = axis.table(
        cellText=cells,
        cellLoc="center",
        bbox=(0, 0, 1, 1),
        colWidths=[w / sum(widths) for w in widths],
    )
    table.auto_set_font_size(False)
    table.set_fontsize(8)
    for (row, column), cell in table.get_celld().items():
        cell.set_linewidth(0.4)
        cell.set_edgecolor("0.75")
        if row == 0 or column < 2:
            cell.set_text_props(weight="bold" if row == 0 else "normal")
            cell.set_facecolor("0.96")
