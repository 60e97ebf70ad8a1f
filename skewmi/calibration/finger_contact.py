"""Where fingers that point down can touch an upright face: the corners of their common hull."""

from __future__ import annotations

import numpy as np

from skewmi.robot_models import yumi
from skewmi.robot_models.yumi import Array

TIP = yumi.GRIPPER.finger_origin_z + yumi.GRIPPER.finger_size[2]
"""Of the fingers, along the flange's axis, m."""


def finger_hull(opening: float) -> Array:
    """Corners of the box around both fingers, in the flange's frame, m.

    Args:
        opening: Travel of each finger from closed, m.

    Returns:
        The four at the tip, then those above them in the same order. Shape (8, 3).
    """
    width, depth, _ = yumi.GRIPPER.finger_size
    x, y = opening + width, depth / 2.0
    low = [(sx * x, sy * y, TIP) for sx in (-1.0, 1.0) for sy in (-1.0, 1.0)]
    return np.array(low + [(cx, cy, yumi.GRIPPER.finger_origin_z) for cx, cy, _ in low])


def touching_points(position: Array, rotation: Array, opening: float, top: float) -> Array:
    """Points of the fingers of which one touches a flat upright face that ends at a height.

    Each edge of the hull that leads up from the tip touches with its lower end or, if it leans
    over the face, where the face ends.

    Args:
        position: Of the flange, base frame, m. Shape (3,).
        rotation: Flange to base. Shape (3, 3).
        opening: Of the fingers, m.
        top: Height of the face, base frame, m.

    Returns:
        Base frame, m. Shape (8, 3).
    """
    corners = position + finger_hull(opening) @ rotation.T
    low, high = corners[:4], corners[4:]
    rise = high[:, 2] - low[:, 2]
    part = np.where(rise > 1e-9, (top - low[:, 2]) / np.maximum(rise, 1e-9), 0.0).clip(0.0, 1.0)
    return np.concatenate((low, low + part[:, None] * (high - low)))
