"""Where runs have been: visited states after so many refreshes, and the targets among them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skewmi.errors import ConfigurationError
from skewmi.evaluation import drawing
from skewmi.evaluation.sweep_figures.figure import Drawn, Request, write_figure
from skewmi.evaluation.sweep_figures.runs import Entry, SweepRuns, distinct, missing
from skewmi.policy_io import Array, PolicyLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes

KEYS = ("refreshes", "steps_per_refresh", "configurations")
TARGET_KEYS = ("configurations",)

Reachable = Callable[[Array], NDArray[np.bool_]]


class Scene:
    """What pictures of a task's states need of it.

    Attributes:
        layouts: By target, the default one first under `default`.
        plane: The two state fields along x and y.
        reachable: For walls, of tasks whose state is those two fields; else None.
    """

    def __init__(
        self,
        layouts: Mapping[str, PolicyLayout],
        plane: tuple[str, str],
        reachable: Reachable | None,
    ) -> None:
        self.layouts, self.plane, self.reachable = layouts, plane, reachable

    @property
    def columns(self) -> list[int]:
        """Of the plane's fields."""
        names = [field.name for field in next(iter(self.layouts.values())).state_fields]
        return [names.index(name) for name in self.plane]


def draw_visits(
    request: Request, runs: SweepRuns, scenes: Mapping[str, Scene], stem: Path, dpi: int
) -> Drawn:
    """A row of panels per task and configuration, a column per number of refreshes.

    Each shows what one run, of the lowest seed with kept states, had visited by then.
    """
    entries = _of_configurations(request, runs)
    refreshes = request.more.get("refreshes", [1, 20, 40, 80])
    if not isinstance(refreshes, list) or not all(type(r) is int and r > 0 for r in refreshes):
        raise ConfigurationError(
            f"figure {request.name}: refreshes is {refreshes!r}; natural numbers are needed"
        )
    shown, lacking = _shown(entries, runs)
    if not shown:
        return Drawn((), (*lacking, "no run has kept states"))
    figure, axes = drawing.new_axes(
        len(shown), len(refreshes), 2.9 * len(refreshes) + 1.0, 2.6 * len(shown)
    )
    rows: list[dict[str, Any]] = []
    for k, (line, entry) in enumerate(zip(axes, shown, strict=True)):
        states = runs.states_of(entry.name)
        scene = scenes[entry.facts["task"]]
        for axis, refresh in zip(line, refreshes, strict=True):
            step = _step(entry, refresh, request)
            rows.append({"configuration": entry.facts["configuration"], "refresh": refresh,
                         **_panel(axis, entry, states, scene, step)})  # fmt: skip
            axis.set_title(_words(rows[-1]), fontsize=8)
            # Labels inside would run into the titles below them.
            if any(later.facts["task"] == entry.facts["task"] for later in shown[k + 1 :]):
                axis.set_xlabel("")
            axis.set_ylabel("")
        line[0].set_ylabel(f"{entry.facts['configuration']}\n{scene.plane[1]}", fontsize=8)
    drawing.set_title(figure, f"{request.title}: visited states after so many refreshes", 11)
    return Drawn(write_figure(figure, rows, stem, dpi), tuple(lacking))


def draw_targets(
    request: Request, runs: SweepRuns, scenes: Mapping[str, Scene], stem: Path, dpi: int
) -> Drawn:
    """A panel per task: where its targets are, over what a run without any has visited."""
    entries = _of_configurations(request, runs)
    tasks = distinct(entries, "task")
    shown, lacking = _shown(entries, runs)
    figure, axes = drawing.new_axes(1, len(tasks), 6.0 * len(tasks), 4.6)
    rows: list[dict[str, Any]] = []
    for axis, task in zip(axes[0], tasks, strict=True):
        scene = scenes[task]
        entry = next((e for e in shown if e.facts["task"] == task), None)
        if entry is not None:
            _panel(axis, entry, runs.states_of(entry.name), scene, np.inf)
        first = next(iter(scene.layouts.values()))
        if scene.reachable is not None:
            _walls(axis, scene, first)
        for name, layout in scene.layouts.items():
            drawing.draw_region(axis, layout, scene.columns)
            centre = _centre(layout, scene)
            axis.annotate(
                name, centre, xytext=(9, 9), textcoords="offset points", fontsize=9, weight="bold",
                zorder=5, bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1},
            )  # fmt: skip
            rows.append({"task": task, "target": name,
                         **dict(zip(("x", "y"), centre, strict=True)),
                         "plane": " ".join(scene.plane)})  # fmt: skip
        _labels(axis, first, scene)
        axis.set_title(str(task).replace("_", " "))
    drawing.set_title(figure, request.title, 11)
    return Drawn(write_figure(figure, rows, stem, dpi), tuple(lacking))


def _of_configurations(request: Request, runs: SweepRuns) -> list[Entry]:
    wanted = request.more.get("configurations")
    entries = runs.of(request.groups)
    if wanted is None:
        return entries
    known = distinct(entries, "configuration")
    if not isinstance(wanted, list) or not set(wanted) <= set(known):
        raise ConfigurationError(
            f"figure {request.name}: configurations is {wanted!r}; of these groups there are "
            f"{', '.join(known)}"
        )
    return [entry for entry in entries if entry.facts["configuration"] in wanted]


def _shown(entries: Sequence[Entry], runs: SweepRuns) -> tuple[list[Entry], list[str]]:
    """The first run with kept states of each task and configuration, and what has none."""
    shown, lacking = [], []
    for task in distinct(entries, "task"):
        for configuration in distinct(entries, "configuration"):
            mine = [
                e for e in entries
                if e.facts["task"] == task and e.facts["configuration"] == configuration
            ]  # fmt: skip
            found = next((e for e in mine if runs.states_of(e.name)), None)
            if found is not None:
                shown.append(found)
                gone = int(runs.states_of(found.name)["trajectory"].min()) - 1
                if gone:
                    lacking.append(
                        f"{configuration} on {task}: no states of the first {gone:,} trajectories "
                        "are held"
                    )
            elif mine:
                lacking.append(f"{configuration} on {task}: no run has kept its states")
    return shown, lacking + missing(shown)


def _step(entry: Entry, refresh: int, request: Request) -> float:
    """The environment step of a refresh: as it was noted, or else by their distance."""
    noted = entry.curve("refresh", "step")
    if noted is not None:
        reached = np.flatnonzero(noted.x >= refresh)
        return float(noted.y[reached[0]]) if len(reached) else np.inf
    return float(refresh * request.more.get("steps_per_refresh", 5_000))


def _panel(
    axis: Axes, entry: Entry, states: Mapping[str, Array], scene: Scene, step: float
) -> dict[str, Any]:
    """Draw one, and say what it shows."""
    reached = entry.curve("step", "trajectories")
    cells = entry.curve("step", "covered_cells")
    last = np.inf if reached is None else float(reached.at(np.array([step]), hold=True)[0])
    seen = states["trajectory"] <= last
    layout = next(iter(scene.layouts.values()))
    if scene.reachable is not None:
        _walls(axis, scene, layout)
    x, y = (states[name][seen] for name in scene.plane)
    axis.scatter(x, y, c=states["trajectory"][seen], s=1.2, linewidths=0, cmap="viridis",
                 vmin=0, vmax=states["trajectory"].max(), rasterized=True)  # fmt: skip
    _labels(axis, layout, scene)
    end = float(reached.x[-1]) if reached is not None else np.inf
    share = None if cells is None else float(cells.at(np.array([min(step, end)]), hold=True)[0])
    return {
        "task": entry.facts["task"],
        "run": entry.name,
        "trajectories": int(states["trajectory"][seen].max()) if seen.any() else 0,
        "covered_cells": share,
        "reached": bool(step <= end),
    }


def _words(row: Mapping[str, Any]) -> str:
    share = "" if row["covered_cells"] is None else f", {row['covered_cells']:.0%} of cells"
    if not row["reached"]:
        return f"refresh {row['refresh']}: not reached\n(at {row['trajectories']:,} traj.{share})"
    return f"refresh {row['refresh']}\n{row['trajectories']:,} trajectories{share}"


def _labels(axis: Axes, layout: PolicyLayout, scene: Scene) -> None:
    x, y = (layout.state_fields[column] for column in scene.columns)
    axis.set_xlabel(f"{x.name.replace('_', ' ')} [{x.unit}]", fontsize=8)
    axis.set_ylabel(f"{y.name.replace('_', ' ')} [{y.unit}]", fontsize=8)
    axis.set_xlim(x.low, x.high)
    axis.set_ylim(y.low, y.high)
    if layout.state_dim == 2:
        axis.set_aspect("equal")


def _walls(axis: Axes, scene: Scene, layout: PolicyLayout) -> None:
    assert scene.reachable is not None
    extent, states = drawing.raster(layout, scene.columns, 300)
    blocked = ~scene.reachable(states)
    axis.imshow(np.where(blocked, 0.35, 0.0), extent=extent, origin="lower", cmap="Greys",
                vmin=0.0, vmax=1.0, zorder=0)  # fmt: skip


def _centre(layout: PolicyLayout, scene: Scene) -> tuple[float, float]:
    """Of the reward region in the plane; the middle of the range of a field that it leaves open."""
    names = {field.name: 0.5 * (field.low + field.high) for field in layout.state_fields}
    for ball in layout.reward_region:
        names |= dict(zip(ball.fields, ball.centre, strict=True))
    return names[scene.plane[0]], names[scene.plane[1]]
