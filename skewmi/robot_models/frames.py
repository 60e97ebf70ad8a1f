"""Frames of the tasks and conversions between descriptions of orientation.

A rotation matrix R_ab takes vectors of frame b to frame a: v_a = R_ab v_b.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from skewmi.robot_models.yumi import Array

BASE_IN_WORLD: Array = np.array([-0.4, 0.0, 0.0])
"""Origin of the robot base frame in the task world, m. The axes are parallel; the table top is
the plane z = 0 of both (published Skew-Explore scene)."""

HAND_DOWN_QUATERNION_WXYZ: Array = np.array([0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0])
"""Orientation of the hand (flange, tool0) in the tasks: z down, x along world +y, y along +x."""

HAND_DOWN: Array = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""The same as a rotation matrix, hand to world (or base)."""

for _array in (BASE_IN_WORLD, HAND_DOWN_QUATERNION_WXYZ, HAND_DOWN):
    _array.flags.writeable = False


def world_to_base(position_w: ArrayLike) -> Array:
    """A point of the task world in the robot base frame, m. Shape (..., 3)."""
    return np.asarray(position_w, dtype=np.float64) - BASE_IN_WORLD


def base_to_world(position_b: ArrayLike) -> Array:
    """A point of the robot base frame in the task world, m. Shape (..., 3)."""
    return np.asarray(position_b, dtype=np.float64) + BASE_IN_WORLD


def rotation_about(axis: int, angle: float) -> Array:
    """Rotation by `angle` (rad) about coordinate axis 0, 1 or 2. Shape (3, 3)."""
    rotation = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(angle), np.sin(angle)
    rotation[i, i], rotation[i, j], rotation[j, i], rotation[j, j] = c, -s, s, c
    return rotation


def rotation_from_rpy(rpy: ArrayLike) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll), as URDF defines it. Shape (3,) -> (3, 3)."""
    roll, pitch, yaw = np.asarray(rpy, dtype=np.float64)
    return rotation_about(2, yaw) @ rotation_about(1, pitch) @ rotation_about(0, roll)


def rpy_from_rotation(rotation: Array) -> Array:
    """Inverse of `rotation_from_rpy`; at pitch = ±pi/2 roll is zero. Shape (3, 3) -> (3,)."""
    cos_pitch = np.hypot(rotation[0, 0], rotation[1, 0])
    pitch = np.arctan2(-rotation[2, 0], cos_pitch)
    if cos_pitch < 1e-9:
        return np.array([0.0, pitch, np.arctan2(-rotation[0, 1], rotation[1, 1])])
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    return np.array([roll, pitch, np.arctan2(rotation[1, 0], rotation[0, 0])])


def rotation_from_quaternion(quaternion_wxyz: ArrayLike) -> Array:
    """Rotation matrices of quaternions (normalised here). Shape (..., 4) -> (..., 3, 3)."""
    quaternion = np.asarray(quaternion_wxyz, dtype=np.float64)
    quaternion = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_from_rotation(rotation: Array) -> Array:
    """Unit quaternions wxyz, w >= 0, of rotation matrices. Shape (..., 3, 3) -> (..., 4)."""
    r = np.asarray(rotation, dtype=np.float64)
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    # Four times the outer product of the quaternion with itself; its longest row is the
    # numerically best one.
    wx, wy, wz = (
        r[..., 2, 1] - r[..., 1, 2],
        r[..., 0, 2] - r[..., 2, 0],
        r[..., 1, 0] - r[..., 0, 1],
    )
    xy, xz, yz = (
        r[..., 0, 1] + r[..., 1, 0],
        r[..., 0, 2] + r[..., 2, 0],
        r[..., 1, 2] + r[..., 2, 1],
    )
    outer = np.stack(
        [
            np.stack([1 + xx + yy + zz, wx, wy, wz], axis=-1),
            np.stack([wx, 1 + xx - yy - zz, xy, xz], axis=-1),
            np.stack([wy, xy, 1 - xx + yy - zz, yz], axis=-1),
            np.stack([wz, xz, yz, 1 - xx - yy + zz], axis=-1),
        ],
        axis=-2,
    )
    diagonal = np.diagonal(outer, axis1=-2, axis2=-1)
    best = np.argmax(diagonal, axis=-1)[..., None, None]
    quaternion: Array = np.take_along_axis(outer, best, axis=-2)[..., 0, :]
    quaternion = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return np.where(quaternion[..., :1] < 0.0, -quaternion, quaternion)


def rotation_vector(rotation: Array) -> Array:
    """Axis times angle (rad, 0..pi) of rotation matrices. Shape (..., 3, 3) -> (..., 3)."""
    quaternion = quaternion_from_rotation(rotation)
    w, vector = quaternion[..., :1], quaternion[..., 1:]
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    # 2 atan2(s, w) / s tends to 2 / w as s tends to 0.
    scale = np.where(sine > 1e-12, 2.0 * np.arctan2(sine, w) / np.maximum(sine, 1e-12), 2.0 / w)
    return np.asarray(scale * vector)
