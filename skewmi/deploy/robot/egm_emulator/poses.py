"""Poses of the flange as packets tell them: measured and desired together, and only if they change.

A packet has two poses, every 4 ms, for two arms: in numpy, quaternions one by one would take more
time than all the rest of the controller.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from skewmi.deploy.robot.backends.egm.packets import Pose
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.yumi import Side
from skewmi.trajectory import Array


class FlangePoses:
    """Forward kinematics of one arm, with the last result remembered.

    Args:
        side: Which arm.
    """

    def __init__(self, side: Side) -> None:
        self._forward = ArmKinematics(side).forward
        self._joints: Array | None = None
        self._poses: tuple[Pose, Pose] | None = None

    def of(self, measured: Array, desired: Array) -> tuple[Pose, Pose]:
        """Poses at two configurations, rad, each of shape (7,)."""
        joints = np.stack((measured, desired))
        if self._poses is None or self._joints is None or (joints != self._joints).any():
            positions, rotations = self._forward(joints)
            first, second = (
                Pose(position, np.array(quaternion_of(rotation.tolist())))
                for position, rotation in zip(positions, rotations, strict=True)
            )
            self._joints, self._poses = joints, (first, second)
        return self._poses


def quaternion_of(rotation: list[list[float]]) -> tuple[float, float, float, float]:
    """Unit quaternion wxyz of a rotation matrix, w not negative.

    The largest of the four is taken from the diagonal, the others from it (Shepperd 1978).
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    trace = xx + yy + zz
    largest = max(trace, xx, yy, zz)
    if largest == trace:
        w = 1.0 + trace
        four = (w, zy - yz, xz - zx, yx - xy)
    elif largest == xx:
        x = 1.0 + xx - yy - zz
        four = (zy - yz, x, yx + xy, xz + zx)
    elif largest == yy:
        y = 1.0 - xx + yy - zz
        four = (xz - zx, yx + xy, y, zy + yz)
    else:
        z = 1.0 - xx - yy + zz
        four = (yx - xy, xz + zx, zy + yz, z)
    scale = 1.0 / sqrt(sum(value * value for value in four))
    scale = -scale if four[0] < 0.0 else scale
    w, x, y, z = four
    return scale * w, scale * x, scale * y, scale * z
