"""Draw the targets of the two tasks that have five: `python docs/make_targets_picture.py`.

Prints what was drawn by lot and writes `docs/images/targets.png`. The choice is explained where
the targets are kept, in `targets.py` of each task.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon, Rectangle

from skewmi.policy_io import Array
from skewmi.sim.tasks.door_open import parts
from skewmi.sim.tasks.door_open import targets as door
from skewmi.sim.tasks.point_maze import maze
from skewmi.sim.tasks.point_maze import targets as points

SEED = 2020
"""Of both draws: the year of the publication."""
PARTS = 5
GRID = 0.05
"""Cells by which the area of the maze is measured, m."""
PICTURE = Path(__file__).parent / "images" / "targets.png"
_RIM = 16
"""Points on the rim of a region that must be free."""


def inner_walls() -> Array:
    """Walls that ways lead around: x_low, y_low, x_high, y_high, m. Shape (n, 4)."""
    walls = maze.wall_rectangles()
    low, high = walls[:, :2].min(axis=0), walls[:, 2:].max(axis=0)
    inside = (walls[:, :2] > low).all(axis=1) & (walls[:, 2:] < high).all(axis=1)
    inner: Array = walls[inside]
    return inner


def visible(begin: Array, end: Array) -> Array:
    """Whether straight lines stay out of the inner walls; touching is allowed.

    Args:
        begin, end: Points, m, broadcast against each other. Shape (..., 2).

    Returns:
        Shape (...).
    """
    begin, end = np.broadcast_arrays(begin, end)
    way = end - begin
    free = np.ones(way.shape[:-1], dtype=np.bool_)
    for wall in inner_walls():
        low, high = wall[:2] + 1e-9, wall[2:] - 1e-9
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = (low - begin) / way, (high - begin) / way
        # A line along an axis never crosses the sides across it: it is between them or not.
        between = (begin > low) & (begin < high)
        enter = np.where(way == 0, np.where(between, -np.inf, np.inf), np.minimum(first, second))
        leave = np.where(way == 0, np.where(between, np.inf, -np.inf), np.maximum(first, second))
        free &= np.maximum(enter.max(-1), 0.0) >= np.minimum(leave.min(-1), 1.0)
    return free


def way_lengths(point: Array) -> Array:
    """Length of the shortest way from the start around the walls, m. Shape (n, 2) -> (n,)."""
    x_low, y_low, x_high, y_high = inner_walls().T
    corners = np.concatenate(
        [np.stack([x, y], axis=-1) for x in (x_low, x_high) for y in (y_low, y_high)]
    )
    hops = np.linalg.norm(corners[:, None] - corners[None], axis=-1)
    hops[~visible(corners[:, None], corners[None])] = np.inf
    start = np.zeros(2)
    to_corner = np.where(visible(start, corners), np.linalg.norm(corners, axis=-1), np.inf)
    for _ in corners:
        to_corner = np.minimum(to_corner, (to_corner[:, None] + hops).min(axis=0))
    last = np.linalg.norm(point[:, None] - corners[None], axis=-1)
    last[~visible(point[:, None], corners[None])] = np.inf
    around = (to_corner + last).min(axis=1)
    straight = np.where(visible(start, point), np.linalg.norm(point, axis=-1), np.inf)
    length: Array = np.minimum(around, straight)
    return length


def roomy(point: Array) -> Array:
    """Whether the whole region around points is free. Shape (n, 2) -> (n,)."""
    angle = 2.0 * np.pi * np.arange(_RIM) / _RIM
    rim = points.RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    free: Array = maze.is_free(point) & maze.is_free(point[:, None] + rim).all(axis=1)
    return free


def maze_parts() -> Array:
    """Lengths of the way at which one part of the area ends and the next begins, m. (PARTS - 1,)"""
    walls = maze.wall_rectangles()
    low, high = walls[:, :2].min(axis=0), walls[:, 2:].max(axis=0)
    axes = [np.arange(a + GRID / 2, b, GRID) for a, b in zip(low, high, strict=True)]
    cells = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    lengths = way_lengths(cells[roomy(cells)])
    ends: Array = np.quantile(lengths, np.arange(1, PARTS) / PARTS)
    return ends


def drawn_points() -> dict[str, tuple[float, float]]:
    """The targets of the maze, drawn by lot, the published one in place of its part's."""
    generator = np.random.default_rng(SEED)
    walls = maze.wall_rectangles()
    low, high = walls[:, :2].min(axis=0), walls[:, 2:].max(axis=0)
    ends = maze_parts()
    published = np.array(points.TARGETS[points.DEFAULT])
    own = int(np.searchsorted(ends, way_lengths(published[None])[0]))
    found: dict[int, tuple[float, float]] = {own: (float(published[0]), float(published[1]))}
    while len(found) < PARTS:
        point = generator.uniform(low, high)[None]
        if not roomy(point)[0]:
            continue
        part = int(np.searchsorted(ends, way_lengths(point)[0]))
        x, y = point[0].round(2).tolist()
        found.setdefault(part, (x, y))
    return {f"t{part + 1}": found[part] for part in range(PARTS)}


def drawn_angles() -> dict[str, float]:
    """The targets of the door, drawn by lot, the published one in place of its part's."""
    generator = np.random.default_rng(SEED)
    ends = np.linspace(*door.AREA, PARTS + 1)
    angles = generator.uniform(ends[:-1], ends[1:]).round(2).tolist()
    published = door.TARGETS[door.DEFAULT]
    angles[int(np.searchsorted(ends, published)) - 1] = published
    return {f"t{part + 1}": angle for part, angle in enumerate(angles)}


def draw_maze(axes: Axes) -> None:
    """The maze with its targets, and where the parts of its area end."""
    for x_low, y_low, x_high, y_high in maze.wall_rectangles():
        axes.add_patch(Rectangle((x_low, y_low), x_high - x_low, y_high - y_low, color="0.25"))
    x, y = np.meshgrid(np.linspace(-8.99, 0.99, 300), np.linspace(-4.99, 4.99, 300))
    cells = np.stack([x, y], axis=-1).reshape(-1, 2)
    part = np.searchsorted(maze_parts(), way_lengths(cells)).astype(float)
    part[~maze.is_free(cells)] = np.nan
    axes.pcolormesh(x, y, part.reshape(x.shape), cmap="Blues", vmin=-1.0, vmax=8.0)
    for name, (x_target, y_target) in points.TARGETS.items():
        axes.add_patch(Circle((x_target, y_target), points.RADIUS, color="tab:red"))
        axes.annotate(name, (x_target, y_target), (4, 4), textcoords="offset points")
    axes.plot(0.0, 0.0, "ko", markersize=4)
    axes.annotate("start", (0.0, 0.0), (4, -10), textcoords="offset points")
    axes.set(aspect="equal", xlabel="x, m", ylabel="y, m", title="PointMaze")


def draw_door(axes: Axes) -> None:
    """The door seen along its hinge, shut and at its targets."""
    (_, y_low, z_low), (_, y_high, z_high) = parts.PANEL
    corners = np.array([(y_low, z_low), (y_high, z_low), (y_high, z_high), (y_low, z_high)])
    hinge = np.array(parts.DOOR_HINGE[1:])
    bar = np.array(parts.HANDLE_BAR_CENTRE[1:])
    for name, angle in {"shut": 0.0, **door.TARGETS}.items():
        cos, sin = math.cos(angle), math.sin(angle)
        # Seen from beyond the far end, towards the robot: +y is on the right.
        turn = np.array([[cos, -sin], [sin, cos]])
        panel = hinge + (corners - hinge) @ turn.T
        colour = "0.7" if name == "shut" else "tab:red"
        axes.add_patch(Polygon(panel * 1e3, facecolor=colour, edgecolor="k", alpha=0.35))
        y, z = (hinge + turn @ (bar - hinge)) * 1e3
        axes.add_patch(Circle((y, z), parts.HANDLE_BAR_RADIUS * 1e3, color=colour))
        edge = panel[1] * 1e3
        label = name if name == "shut" else f"{name}: {angle:.4g} rad"
        axes.annotate(label, edge, (5, 2), textcoords="offset points", fontsize=8)
    axes.plot(*hinge * 1e3, "k+")
    axes.axhline(0.0, color="0.4")
    axes.set(aspect="equal", xlim=(-100, 160), ylim=(-5, 230))
    axes.set(xlabel="y, mm", ylabel="z, mm", title="DoorOpen, along its hinge")


def main() -> None:
    """Print the draws and write the picture."""
    sys.stdout.write(f"maze {drawn_points()}\n")
    sys.stdout.write(f"door {drawn_angles()}\n")
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(10.5, 4.6), layout="constrained")
    draw_maze(left)
    draw_door(right)
    figure.savefig(PICTURE, dpi=110)


if __name__ == "__main__":
    main()
