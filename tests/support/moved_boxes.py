"""Boxes that stand elsewhere, and robots that are really moved: written apart from the package."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np

from skewmi.calibration.calibration_file import Calibration, Constant, SceneCalibration
from skewmi.policy_io import Array
from skewmi.robot_models import mjcf, yumi

ORIGIN = (-0.009, -0.0735)
"""Middle of OpenPressClose's box, m."""
Displacement = tuple[float, float, float]
"""x (m), y (m), yaw_deg."""


def found_at(x: float, y: float, yaw_deg: float, *, half_width: float = 1e-4) -> SceneCalibration:
    """A scene whose box was found there; the lid reads what it should."""

    def known(value: float) -> Constant:
        return Constant((value,), (value - half_width,), (value + half_width,), (False,))

    zeros = ((0.0,) * 3,) * 3
    return SceneCalibration(known(x), known(y), known(yaw_deg), Constant.known(0.0), zeros)


def calibration_at(
    x: float, y: float, yaw_deg: float, *, servo: Calibration | None = None
) -> Calibration:
    """Of the scene alone, or added to that of servos."""
    scene = found_at(x, y, yaw_deg)
    if servo is not None:
        return replace(servo, scene=scene)
    return Calibration("2026-01-02T03:04:05Z", "1.2.3", scene=scene)


def drawn(rng: np.random.Generator, shift: float = 0.025, turn_deg: float = 10.0) -> Displacement:
    """Uniform."""
    x, y, yaw = rng.uniform(-1.0, 1.0, 3) * (shift, shift, turn_deg)
    return float(x), float(y), float(yaw)


def homogeneous(yaw: float, x: float, y: float, z: float = 0.0) -> Array:
    """Turn about the vertical, rad, then shift, m. Shape (4, 4)."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])


def box_moved(displacement: Displacement, origin: tuple[float, float] = ORIGIN) -> Array:
    """What the displacement does to points of the box, in the frame of the nominal one. (4, 4)"""
    x, y, yaw_deg = displacement
    about = homogeneous(0.0, *origin)
    turn = homogeneous(np.radians(yaw_deg), 0.0, 0.0)
    return homogeneous(0.0, x, y) @ about @ turn @ np.linalg.inv(about)


def base_in_box(displacement: Displacement, origin: tuple[float, float] = ORIGIN) -> Array:
    """The robot base in the displaced box's frame. Shape (4, 4)."""
    return np.linalg.inv(box_moved(displacement, origin)) @ homogeneous(0.0, -0.4, 0.0)


@cache
def _moved_robot(displacement: Displacement) -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = mjcf.build_robot(collision=False, visual=False)
    base = base_in_box(displacement)
    body = spec.body(yumi.BODY_NAME)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, base[:3, :3].ravel())
    body.pos, body.quat = base[:3, 3], quaternion
    model = spec.compile()
    return model, mujoco.MjData(model)


def hand_by_mujoco(q: Array, displacement: Displacement) -> tuple[Array, Array]:
    """Flange in the box's frame by MuJoCo, whose robot really stands elsewhere.

    Args:
        q: rad. Shape (7,).
        displacement: Of the box.

    Returns:
        Position, m, shape (3,), and rotation, shape (3, 3).
    """
    model, data = _moved_robot(displacement)
    for name, value in zip(yumi.joint_names("right"), q, strict=True):
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    site = data.site(yumi.tool_name("right"))
    return site.xpos.copy(), site.xmat.reshape(3, 3).copy()
