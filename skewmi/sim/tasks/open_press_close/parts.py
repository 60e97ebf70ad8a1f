"""The things of OpenPressClose that are not the robot: table, box, lid with handle, button.

Geometry: the boxes of the Skew-Explore "yumi_door_button" scene of its
authors' published code (MIT), restated in world coordinates: x forward from the robot, y to its
left, z up, table top at z = 0.
Departures, each because the original is not physical (1 % of Earth's gravity, massless button):
handle posts 4 mm further out, real masses, hinge and slide held by dry friction.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LID_HINGE = (0.1, -0.005, 0.075)
"""A point of the lid's hinge line, which is parallel to x; world, m."""
LID_MAX = 2.5
"""Lid angle at the open stop, rad."""
LID_FRICTIONLOSS = 0.12
"""Dry friction of the hinge, N m: more than the lid's weight gives (0.10 when shut), so that the
lid stays wherever it is left."""
LID_DAMPING = 0.02
"""Viscous friction of the hinge, N m s/rad."""
LID_PLATE_MASS = 0.08
HANDLE_MASS = 0.03
"""Masses, kg: a 2 mm plate of plastic with its hinge leaf, a printed handle."""

BOX_ORIGIN = (-0.009, -0.0735, 0.0)
"""Origin of the body `box`, which carries walls, lid and button: the middle of its footprint.
Moving or turning this one body moves the whole box; world, m."""

BUTTON_TRAVEL = 0.03
"""Depth of the button's lower stop, m; 0 is up."""
BUTTON_FRICTIONLOSS = 3.0
"""Dry friction of the button's slide, N: holds it where it is pushed."""
BUTTON_DAMPING = 5.0
"""Viscous friction of the button's slide, N s/m."""
BUTTON_MASS = 0.05
"""kg. Its weight is balanced (gravity compensation), as by a counter-spring."""

# Box-shaped parts: low corner, high corner, world, m, lid shut and button up.
_WALLS = {
    "box_wall_near": ((-0.118, -0.150, 0.0), (-0.109, 0.003, 0.083)),
    "box_wall_far": ((0.091, -0.150, 0.0), (0.100, 0.003, 0.083)),
    "box_wall_front": ((-0.109, -0.150, 0.0), (0.091, -0.145, 0.072)),
    "box_wall_hinge": ((-0.109, -0.002, 0.0), (0.091, 0.003, 0.065)),
}
_LID_PLATE = ((-0.103, -0.150, 0.074), (0.085, -0.010, 0.076))
_HANDLE = {
    "handle_post_near": ((-0.042, -0.1435, 0.076), (-0.034, -0.1355, 0.112)),
    "handle_post_far": ((0.016, -0.1435, 0.076), (0.024, -0.1355, 0.112)),
    "handle_bar": ((-0.042, -0.1435, 0.112), (0.024, -0.1355, 0.120)),
}
_BUTTON = ((-0.052, -0.115, 0.050), (0.028, -0.035, 0.070))
_WORK_SURFACE = ((-0.25, -0.45, -0.1), (0.35, 0.45, 0.0))
"""A raised surface in front of the robot: the feet of the robot stand 0.1 m lower."""
_FLOOR_PLATE = ((-0.80, -0.60, -0.13), (0.45, 0.60, -0.1))

HANDLE_BAR_CENTRE = (-0.009, -0.1395, 0.116)
"""Centre of the handle's bar with the lid shut, world, m."""

FRICTION = 0.5
"""Sliding friction wherever robot and scene touch: plastic on plastic, dry."""

# Contact: the dynamics live in the robot; everything here is hit by it and not by each other,
# because lid and button are stopped by their joints.
_CONTACT = {
    "contype": 0,
    "conaffinity": 1,
    "friction": (FRICTION, 0.005, 0.0001),
    "solref": (0.01, 1.0),
    "solimp": (0.95, 0.99, 0.001, 0.5, 2.0),
}
# A dry-friction constraint of MuJoCo lets the joint creep at a speed that grows with its
# softness: with the defaults the button sank 9 mm/s under a resting finger.
_STIFF_FRICTION = {
    "solref_friction": (0.01, 1.0),
    "solimp_friction": (0.9999, 0.9999, 0.001, 0.5, 2.0),
}
STIFF_LIMIT = {
    "solref_limit": (0.008, 1.0),
    "solimp_limit": (0.99, 0.9999, 0.001, 0.5, 2.0),
}
"""A joint's stop as stiff as it can be: two time steps is where it is still stable."""
_BUMPER = {**STIFF_LIMIT, "solref_limit": (0.015, 1.0)}
"""The lid lands on rubber, which gives way by up to 1 mm: shut by a hand at 150 mm/s on the
stiffest of stops, the hand met peaks of 155 N; so it meets 100 N."""

_WOOD = (0.80, 0.68, 0.50, 1.0)
_DARK = (0.30, 0.32, 0.35, 1.0)
_GREY = (0.62, 0.64, 0.66, 1.0)
_LID_BLUE = (0.25, 0.45, 0.70, 1.0)
_HANDLE_RED = (0.80, 0.22, 0.18, 1.0)
_BUTTON_YELLOW = (0.95, 0.75, 0.15, 1.0)

Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def _add_box(
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
        **_CONTACT,
    )


def add_parts(spec: mujoco.MjSpec) -> None:
    """Add table, box, lid, button, lights and cameras to a spec whose origin is the world's.

    Adds the joints `lid_hinge` (rad, 0 shut, positive open) and `button_slide` (m, 0 up,
    positive pressed) and the cameras `overview`, `side`, `front` and `close`.
    """
    world = spec.worldbody
    _add_box(world, "floor_plate", _FLOOR_PLATE, _GREY)
    _add_box(world, "work_surface", _WORK_SURFACE, _WOOD)
    box = world.add_body(name="box", pos=BOX_ORIGIN)
    for name, corners in _WALLS.items():
        _add_box(box, name, corners, _DARK, origin=BOX_ORIGIN)

    lid = box.add_body(name="lid", pos=np.subtract(LID_HINGE, BOX_ORIGIN))
    lid.add_joint(
        name="lid_hinge",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=(-1.0, 0.0, 0.0),
        range=(0.0, LID_MAX),
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        frictionloss=LID_FRICTIONLOSS,
        damping=[LID_DAMPING, 0.0, 0.0],
        armature=2e-4,
        **_STIFF_FRICTION,
        **_BUMPER,
    )
    _add_box(lid, "lid_plate", _LID_PLATE, _LID_BLUE, origin=LID_HINGE, mass=LID_PLATE_MASS)
    for name, corners in _HANDLE.items():
        share = HANDLE_MASS / len(_HANDLE)
        _add_box(lid, name, corners, _HANDLE_RED, origin=LID_HINGE, mass=share)

    button_centre = np.mean(_BUTTON, axis=0)
    button = box.add_body(name="button", pos=button_centre - BOX_ORIGIN, gravcomp=1.0)
    button.add_joint(
        name="button_slide",
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=(0.0, 0.0, -1.0),
        range=(0.0, BUTTON_TRAVEL),
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        frictionloss=BUTTON_FRICTIONLOSS,
        damping=[BUTTON_DAMPING, 0.0, 0.0],
        **_STIFF_FRICTION,
        **STIFF_LIMIT,
    )
    _add_box(
        button, "button_plate", _BUTTON, _BUTTON_YELLOW, origin=button_centre, mass=BUTTON_MASS
    )
    _add_surroundings(spec)


def _add_surroundings(spec: mujoco.MjSpec) -> None:
    """Background, lights and cameras."""
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
