"""The table before the arm, and what parts on it are made of.

World coordinates: x forward from the robot, y to its left, z up, table top at z = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from skewmi.policy_io import Array

FRICTION = 0.5
"""Sliding friction wherever robot and scene touch: plastic on plastic, dry."""

# Contact: the dynamics live in the robot; everything here is hit by it and not by each other,
# because what moves is stopped by its joint.
CONTACT: dict[str, Any] = {
    "contype": 0,
    "conaffinity": 1,
    "friction": (FRICTION, 0.005, 0.0001),
    "solref": (0.01, 1.0),
    "solimp": (0.95, 0.99, 0.001, 0.5, 2.0),
}
# A dry-friction constraint of MuJoCo lets the joint creep at a speed that grows with its
# softness: with the defaults a button sank 9 mm/s under a resting finger.
STIFF_FRICTION: dict[str, Any] = {
    "solref_friction": (0.01, 1.0),
    "solimp_friction": (0.9999, 0.9999, 0.001, 0.5, 2.0),
}
STIFF_LIMIT: dict[str, Any] = {
    "solref_limit": (0.008, 1.0),
    "solimp_limit": (0.99, 0.9999, 0.001, 0.5, 2.0),
}
"""A joint's stop as stiff as it can be: two time steps is where it is still stable."""

WOOD = (0.80, 0.68, 0.50, 1.0)
GREY = (0.62, 0.64, 0.66, 1.0)

_WORK_SURFACE = ((-0.25, -0.45, -0.1), (0.35, 0.45, 0.0))
"""A raised surface in front of the robot: the feet of the robot stand 0.1 m lower."""
_FLOOR_PLATE = ((-0.80, -0.60, -0.13), (0.45, 0.60, -0.1))

Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def add_box(
    body: mujoco.MjsBody,
    name: str,
    corners: Box,
    rgba: tuple[float, ...],
    *,
    origin: Sequence[float] | Array = (0.0, 0.0, 0.0),
    mass: float = 0.0,
) -> None:
    """Add a box given by its corners in world; `origin` is the body's origin in world."""
    low, high = np.array(corners[0]), np.array(corners[1])
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(high - low) / 2,
        pos=(low + high) / 2 - np.asarray(origin),
        rgba=rgba,
        mass=mass,
        **CONTACT,
    )


def add_table(spec: mujoco.MjSpec) -> None:
    """Add floor and work surface to a spec whose origin is the world's."""
    add_box(spec.worldbody, "floor_plate", _FLOOR_PLATE, GREY)
    add_box(spec.worldbody, "work_surface", _WORK_SURFACE, WOOD)


def add_surroundings(spec: mujoco.MjSpec) -> None:
    """Add background, lights and the cameras `overview`, `side`, `front` and `close`."""
    spec.add_texture(
        name="background",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.88, 0.91, 0.94),
        rgb2=(0.50, 0.57, 0.65),
        width=128,
        height=768,
    )
    spec.visual.quality.shadowsize = 4096
    world = spec.worldbody
    directional = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    world.add_light(
        name="key",
        type=directional,
        pos=(0.6, -0.8, 1.5),
        dir=(-0.4, 0.5, -1.0),
        castshadow=True,
        diffuse=(0.7, 0.7, 0.7),
    )
    world.add_light(
        name="fill",
        type=directional,
        pos=(0.8, 0.8, 1.2),
        dir=(-0.6, -0.6, -0.8),
        castshadow=False,
        diffuse=(0.35, 0.35, 0.38),
    )
    for name, eye, target, fovy in (
        ("overview", (0.88, -0.85, 0.66), (-0.17, -0.08, 0.17), 45.0),
        ("side", (0.75, -0.07, 0.28), (-0.05, -0.05, 0.14), 40.0),
        ("front", (0.10, -0.80, 0.32), (-0.02, -0.05, 0.12), 40.0),
        ("close", (0.42, -0.42, 0.30), (-0.01, -0.08, 0.10), 40.0),
    ):
        _add_camera(world, name, eye, target, fovy)


def _add_camera(
    world: mujoco.MjsBody,
    name: str,
    eye: tuple[float, float, float],
    target: tuple[float, float, float],
    fovy_deg: float,
) -> None:
    """Add a fixed camera at `eye` looking at `target`, both world, m, with z up in the image."""
    back = np.array(eye) - np.array(target)
    back /= np.linalg.norm(back)
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    rotation = np.column_stack((right, np.cross(back, right), back))
    quaternion_wxyz = np.empty(4)
    mujoco.mju_mat2Quat(quaternion_wxyz, rotation.ravel())
    world.add_camera(name=name, pos=eye, quat=quaternion_wxyz, fovy=fovy_deg)
