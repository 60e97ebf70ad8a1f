"""Geometry of the point maze: where a point may be, and what one step does.

The maze is a 7x7 grid of 2 m cells whose free cells form an eight lying on its side (rows 1 and
5, columns 1, 3 and 5). Rows grow along +y and columns along +x; the start cell, row 3 of column
5, is centred on the origin. The grid therefore spans x -11..3 m, y -7..7 m and its free part
x -9..1 m, y -5..5 m, 76 m^2. Source: the point maze of Skew-Explore (rllab's, 2 m cells).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import TIME_FIELD, ActionField, Array, Ball, Field, PolicyLayout
from skewmi.sim.checks import chosen_target
from skewmi.sim.tasks.point_maze import targets

CELL_SIZE = 2.0
"""Side of a cell, m."""

START_CELL = (3, 5)
"""Row and column of the cell whose centre is the origin and the start."""

FREE_CELLS: NDArray[np.bool_] = np.array(
    [[character == "." for character in row] for row in (
        "#######",
        "#.....#",
        "#.#.#.#",
        "#.#.#.#",
        "#.#.#.#",
        "#.....#",
        "#######",
    )]
)  # fmt: skip
"""Which cells are free. Shape (7, 7), row (y) first."""
FREE_CELLS.setflags(write=False)

STEP_SIZE = 0.12
"""Displacement per axis of an action of 1, m."""

CONTROL_DT = 0.1
"""Seconds between two actions: as in the arm tasks, the maze itself has no clock."""

EPISODE_STEPS = 200

TARGET = targets.TARGETS[targets.DEFAULT]
"""Centre of the reward region while no other target is chosen, m."""

TARGET_RADIUS = targets.RADIUS
"""Radius of the reward region, m."""


def layout(*, time_input: bool = False, target: str | None = None) -> PolicyLayout:
    """What a policy sees (x, y, on request the episode time) and does (a step in x and y).

    The nominal range of x and y is the rectangle over which the authors take entropy and
    coverage (x -12..4 m, y -6..6 m), so that metrics need no range of their own.

    Args:
        time_input: Whether the observation ends with step index / episode_steps.
        target: Name of what is rewarded, one of `targets.TARGETS`; without it, `TARGET`.

    Raises:
        NotFoundError: There is no such target; the message lists those that exist.
    """
    centre = TARGET if target is None else chosen_target("point_maze", targets.TARGETS, target)
    position = (
        Field("x", "m", "world", -12.0, 4.0),
        Field("y", "m", "world", -6.0, 6.0),
    )
    time = (Field(TIME_FIELD, "1", "episode", 0.0, 1.0),) if time_input else ()
    return PolicyLayout(
        task="point_maze",
        observation=position + time,
        action=(
            ActionField("step_x", "m/step", "world", STEP_SIZE),
            ActionField("step_y", "m/step", "world", STEP_SIZE),
        ),
        reward_region=(Ball(("x", "y"), centre, TARGET_RADIUS),),
        control_dt=CONTROL_DT,
        episode_steps=EPISODE_STEPS,
        success_hold_steps=1,
    )


def is_free(position: Array) -> NDArray[np.bool_]:
    """Whether points are clear of every wall; touching one counts as inside it.

    Args:
        position: World x, y in m. Shape (..., >= 2).

    Returns:
        Shape (...). False for what is not finite.
    """
    position = np.asarray(position, dtype=np.float64)
    x, y = position[..., 0], position[..., 1]
    x_low, y_low, x_high, y_high = _FREE_BOUNDS
    free: NDArray[np.bool_] = (x > x_low) & (x < x_high) & (y > y_low) & (y < y_high)
    for x_low, y_low, x_high, y_high in _INNER_WALLS:
        free &= (x < x_low) | (x > x_high) | (y < y_low) | (y > y_high)
    return free


def move(position: Array, action: Array) -> Array:
    """Where one step leads: a step that would end in a wall is not taken at all.

    Only the end point is tested, as in the original: a step is far shorter than a wall is
    thick, so nothing tunnels, but the tip of a corner can be cut.

    Args:
        position: World x, y in m. Shape (..., 2).
        action: In [-1, 1] per axis (clipped here). Shape (..., 2).

    Returns:
        New position in m. Shape (..., 2).
    """
    proposed = position + STEP_SIZE * np.clip(action, -1.0, 1.0)
    result: Array = np.where(is_free(proposed)[..., None], proposed, position)
    return result


def wall_rectangles() -> Array:
    """The walls as few rectangles as a scan by rows and columns finds, for pictures and MJCF.

    Returns:
        Each row is x_low, y_low, x_high, y_high in m, world. Shape (n, 4). The rectangles do
        not overlap and their union is every wall cell.
    """
    left = ~FREE_CELLS
    rectangles = []
    for row, column in np.argwhere(~FREE_CELLS):
        if not left[row, column]:
            continue
        width = 1
        while column + width < left.shape[1] and left[row, column + width]:
            width += 1
        height = 1
        while row + height < left.shape[0] and left[row + height, column : column + width].all():
            height += 1
        left[row : row + height, column : column + width] = False
        rectangles.append((column, row, column + width, row + height))
    return _to_world(np.array(rectangles))


def _to_world(cells: NDArray[np.intp]) -> Array:
    """Rectangles of cells (column, row, end column, end row) in m. Shape (..., 4)."""
    offset = np.array([START_CELL[1], START_CELL[0]] * 2) + 0.5
    scaled: Array = (cells - offset) * CELL_SIZE
    return scaled


_rows, _columns = np.nonzero(FREE_CELLS)
_FREE_BOUNDS = _to_world(
    np.array([_columns.min(), _rows.min(), _columns.max() + 1, _rows.max() + 1])
).tolist()
"""Rectangle around everything free, m: all beyond is wall or outside of the maze."""

_INNER_WALLS = [
    rectangle
    for rectangle in wall_rectangles().tolist()
    if rectangle[0] < _FREE_BOUNDS[2]
    and rectangle[1] < _FREE_BOUNDS[3]
    and rectangle[2] > _FREE_BOUNDS[0]
    and rectangle[3] > _FREE_BOUNDS[1]
]
"""Walls inside of it: the others need no test of their own."""
