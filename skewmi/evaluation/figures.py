"""Pictures of one run: curves of all that was measured, and the states it has visited."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from skewmi.evaluation import drawing
from skewmi.evaluation.learning import read_table
from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.checkpoint import read_checkpoint
from skewmi.train.config import TrainConfig
from skewmi.train.visited import visited_trajectories

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Reachable = Callable[[Array], NDArray[np.bool_]]
"""Which states can be reached. Shape (..., state_dim) -> (...)."""

_CURVES: tuple[tuple[str, tuple[tuple[str, str], ...]], ...] = (
    ("entropy (as published: no cell area)", (("entropy", ""),)),
    ("differential entropy, nats", (("differential_entropy", ""),)),
    ("coverage", (("covered_cells", "reachable cells"), ("coverage", "as published"))),
    (
        "rewarded share",
        (
            ("rewarded_fraction", "of episodes"),
            ("evaluation_fraction", "of last states, evaluation"),
        ),
    ),
    ("extrinsic return", (("return", "training"), ("evaluation_return", "evaluation"))),
    ("policy entropy, nats", (("policy_entropy", "entropy"),)),
)
_TEMPERATURE = "temperature"
"""Of those learners that have one; beside the entropy."""
_MAX_POINTS = 60_000


def draw_curves(run_dir: Path, path: Path, dpi: int) -> Path:
    """Curves of the run's table against trajectories.

    Raises:
        CheckpointError: The table is missing or empty.
    """
    table = read_table(run_dir)
    figure, axes = drawing.new_axes(2, 3, 12.0, 6.2)
    trajectories = np.array(table["trajectories"])
    for axis, (title, curves) in zip(axes.ravel(), _CURVES, strict=True):
        for (name, label), colour in zip(curves, (drawing.BLUE, drawing.ORANGE), strict=False):
            values = np.array(table.get(name, np.full(len(trajectories), np.nan)))
            known = np.isfinite(values)
            axis.plot(trajectories[known], values[known], color=colour, label=label or None)
        if curves[0][0] == "policy_entropy" and _TEMPERATURE in table:
            right = axis.twinx()
            right.semilogy(trajectories, np.array(table[_TEMPERATURE]), color=drawing.ORANGE)
            right.set_ylabel(_TEMPERATURE, color=drawing.ORANGE)
        elif len(curves) > 1:
            axis.legend(frameon=False, fontsize=8)
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("trajectories")
        axis.set_xlim(left=0)
    _mark_discoveries(run_dir, axes.ravel()[2])
    drawing.set_title(figure, f"{run_dir.name}: {int(table['step'][-1]):,} environment steps", 11)
    drawing.save(figure, path, dpi)
    return path


def _mark_discoveries(run_dir: Path, axis: Axes) -> None:
    """Vertical lines at first times."""
    found = read_checkpoint(run_dir).state["discoveries"]
    for k, (name, first) in enumerate(found.items()):
        axis.axvline(first["trajectory"], color=drawing.GREY, linewidth=0.7, linestyle=":")
        axis.text(
            first["trajectory"], 0.02 + 0.07 * k, f" {name}", fontsize=6.5, color=drawing.GREY,
            transform=axis.get_xaxis_transform(),
        )  # fmt: skip


def draw_coverage(
    run_dir: Path,
    config: TrainConfig,
    layout: PolicyLayout,
    path: Path,
    dpi: int,
    *,
    reachable: Reachable | None = None,
) -> Path:
    """Visited states over what is reachable, coloured by the trajectory that they were met in.

    A task with two state fields gets one panel, with its walls; others one for the first two
    measured fields and one for the hand's vertical plane, as far as the layout has them.

    Args:
        run_dir: Of the run.
        config, layout: Of the run.
        path: Picture file to write.
        dpi: Dots per inch.
        reachable: `BatchEnv.reachable` of the run's task, for the walls of two state fields; None
            draws none.
    """
    states, numbers = visited_trajectories(run_dir)
    trajectories = np.repeat(numbers, states.shape[1])
    flat = states.reshape(-1, states.shape[-1])
    if len(flat) > _MAX_POINTS:
        chosen = np.random.default_rng(0).choice(len(flat), size=_MAX_POINTS, replace=False)
        chosen.sort()
        flat, trajectories = flat[chosen], trajectories[chosen]
    names = [field.name for field in layout.state_fields]
    grid = [names.index(axis.field) for axis in config.task_metrics.grid[:2]]
    panels = [grid if len(grid) == 2 else [0, 1]]
    if {"hand_y", "hand_z"} <= set(names):
        panels.append([names.index("hand_y"), names.index("hand_z")])
    figure, axes = drawing.new_axes(1, len(panels), 6.5 * len(panels), 5.0)
    outlined = []
    for axis, columns in zip(axes[0], panels, strict=True):
        plane = layout.state_dim == 2
        if plane and reachable is not None:
            _draw_walls(axis, reachable, layout, columns)
        points = axis.scatter(
            flat[:, columns[0]], flat[:, columns[1]], c=trajectories, s=2.0, linewidths=0,
            cmap="viridis", rasterized=True,
        )  # fmt: skip
        outlined.append(drawing.draw_region(axis, layout, columns))
        for column, label in zip(columns, (axis.set_xlabel, axis.set_ylabel), strict=True):
            field = layout.state_fields[column]
            label(f"{field.name} [{field.unit}]")
        if plane:
            axis.set_aspect("equal")
    figure.colorbar(points, ax=axes[0], label="trajectory", shrink=0.8)
    meaning = "rewarded states" if config.rewarded else "states of the target, not rewarded here,"
    legend = f"; {meaning} lie inside orange" if any(outlined) else ""
    held, made = len(numbers), int(numbers[-1])
    which = f"{made:,}" if held == made else f"the last {held:,} of {made:,}"
    drawing.set_title(
        figure, f"{layout.task}: states visited in {which} trajectories{legend}", fontsize=11
    )
    drawing.save(figure, path, dpi)
    return path


def _draw_walls(
    axis: Axes, reachable: Reachable, layout: PolicyLayout, columns: Sequence[int]
) -> None:
    extent, states = drawing.raster(layout, columns, 400)
    blocked = ~reachable(states)
    axis.imshow(
        np.where(blocked, 0.35, 0.0), extent=extent, origin="lower", cmap="Greys", vmin=0.0,
        vmax=1.0, zorder=0,
    )  # fmt: skip
