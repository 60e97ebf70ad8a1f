"""Boxes around what stands before the robot, from the shapes that its server describes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np

from skewmi.robot_models.base_frame import NOMINAL_BASE, BaseFrame
from skewmi.robot_models.frames import rotation_from_quaternion
from skewmi.robot_models.obstacle import Obstacle
from skewmi.trajectory import Array

TABLE_TOP = 0.001
"""What ends below this is the table, or under it, m."""


class Shape(Protocol):
    """A box of a scene, as `wire.scene_geometry.ScenePart` has it; all in the task world."""

    @property
    def name(self) -> str: ...
    @property
    def joint(self) -> str: ...
    @property
    def half_size(self) -> Sequence[float]: ...
    @property
    def position(self) -> Sequence[float]: ...
    @property
    def quaternion_wxyz(self) -> Sequence[float]: ...


def scene_obstacles(
    shapes: Iterable[Shape], margin: float = 0.0, base: BaseFrame = NOMINAL_BASE
) -> tuple[Obstacle, ...]:
    """One box around all that stands still, and one around what moves with each joint.

    Sides are along the axes of the shapes' frame; joints of the scene are at zero (a lid is shut).
    A box within another one is left out, and so is the table, which the guard knows by itself.

    Args:
        shapes: Of the scene.
        margin: Added on every side, m: for a scene that is not exactly where it is said to be.
        base: The robot base in the frame of the shapes.
    """
    bounds: dict[str, tuple[Array, Array]] = {}
    for shape in shapes:
        low, high = _extent(shape, base)
        if high[2] <= TABLE_TOP:
            continue
        if shape.joint in bounds:
            known = bounds[shape.joint]
            low, high = np.minimum(known[0], low), np.maximum(known[1], high)
        bounds[shape.joint] = low, high
    kept: list[tuple[str, Array, Array]] = []
    # Largest first: what is within another one comes after it, and of equal ones one stays.
    for joint, (low, high) in sorted(bounds.items(), key=_volume, reverse=True):
        if not any((outer <= low).all() and (high <= top).all() for _, outer, top in kept):
            kept.append((f"scene at {joint}" if joint else "scene", low, high))
    return tuple(_obstacle(name, low - margin, high + margin, base) for name, low, high in kept)


def _volume(box: tuple[str, tuple[Array, Array]]) -> float:
    low, high = box[1]
    return float((high - low).prod())


def _extent(shape: Shape, base: BaseFrame) -> tuple[Array, Array]:
    """Corners from the robot base on, along the axes of the shapes' frame."""
    rotation = rotation_from_quaternion(shape.quaternion_wxyz)
    half = np.abs(rotation) @ np.array(shape.half_size, dtype=np.float64)
    centre = np.array(shape.position) - base.position
    return centre - half, centre + half


def _obstacle(name: str, low: Array, high: Array, base: BaseFrame) -> Obstacle:
    x, y, z = base.vectors_to_base((low + high) / 2.0).tolist()
    half_x, half_y, half_z = ((high - low) / 2.0).tolist()
    return Obstacle((x, y, z), (half_x, half_y, half_z), -base.yaw, name)
