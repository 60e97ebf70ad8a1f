"""What the pictures of runs share: axes without frills, colours, reward regions."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from skewmi.outputs import written_aside
from skewmi.policy_io import Array, PolicyLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, ORANGE, GREY = "#2f6f9f", "#d9752b", "#5b6770"


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, inches, that needs no display."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    figure: Figure = pyplot.figure(figsize=(width, height), layout="constrained")
    return figure


def new_axes(rows: int, columns: int, width: float, height: float) -> tuple[Any, Any]:
    """A figure, inches, and its axes, an array of shape (rows, columns)."""
    figure = new_figure(width, height)
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.ravel():
        strip(axis)
    return figure, axes


def save(figure: Any, path: Any, dpi: int) -> None:
    """Write the picture and give its memory back.

    Raises:
        OutputError: It cannot be written.
    """
    from matplotlib import pyplot

    try:
        with written_aside(path) as draft:
            figure.savefig(draft, dpi=dpi)
    finally:
        pyplot.close(figure)


def set_title(figure: Figure, title: str, fontsize: float) -> None:
    """A title above all axes, over as many lines as the figure's width needs.

    Args:
        figure: Whose title.
        title: Of it; line breaks stay.
        fontsize: Points.
    """
    text = figure.suptitle(title, fontsize=fontsize)
    room = 0.97 * figure.get_figwidth() * figure.dpi
    lines: list[str] = []
    for line in title.split("\n"):
        text.set_text(line)
        width = text.get_window_extent().width
        fits = len(line) if width <= room else int(len(line) * room / width)
        lines += textwrap.wrap(line, max(fits, 1)) or [""]
    text.set_text("\n".join(lines))


def strip(axis: Axes) -> None:
    """Leave away the lines that bound nothing."""
    axis.spines[["top", "right"]].set_visible(False)


def raster(layout: PolicyLayout, columns: Sequence[int], points: int) -> tuple[Any, Array]:
    """Extent of two fields' ranges, and a square raster of states over them."""
    fields = [layout.state_fields[c] for c in columns]
    u, v = (np.linspace(f.low, f.high, points) for f in fields)
    states = np.stack(np.meshgrid(u, v), axis=-1)
    return (u[0], u[-1], v[0], v[-1]), states


def draw_region(
    axis: Axes,
    layout: PolicyLayout,
    columns: Sequence[int],
    scale: tuple[float, float] = (1.0, 1.0),
) -> bool:
    """Outline of what the reward region allows these two fields to be, whatever the others are.

    A state is rewarded only if this holds in every plane.

    Args:
        axis: To draw on.
        layout: Of the task.
        columns: The two state fields along x and y.
        scale: Units of the axes per unit of the fields.

    Returns:
        Whether there was one to draw: whether it bounds any of the two more than its range does.
    """
    names = [layout.state_fields[column].name for column in columns]
    extent, plane = raster(layout, columns, 600)
    inside = np.ones(plane.shape[:2])
    for ball in layout.reward_region:
        # Of a ball in other fields, too, this is the shadow.
        shown = [k for k, name in enumerate(ball.fields) if name in names]
        if shown:
            way = plane[..., [names.index(ball.fields[k]) for k in shown]]
            distance = np.linalg.norm(way - np.array(ball.centre)[shown], axis=-1)
            inside[distance > ball.radius] = 0.0
    # What bounds nothing but the ends of the ranges is no news, and would hide what is.
    if inside[1:-1, 1:-1].all():
        return False
    # Closed where it reaches the end of a field's range, too.
    inside[[0, -1]] = 0.0
    inside[:, [0, -1]] = 0.0
    x, y = np.linspace(extent[0], extent[1], 600), np.linspace(extent[2], extent[3], 600)
    axis.contour(
        x * scale[0], y * scale[1], inside, levels=[0.5], colors=ORANGE, linewidths=2.0, zorder=3
    )
    return True
