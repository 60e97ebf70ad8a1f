"""What stands on the table in DoorOpen: a flap that lies flat, its handle, what carries its hinge.

Geometry: the shapes of the Skew-Explore "yumi_door" scene of its authors' published code (MIT), in
world coordinates: x forward from the robot, y to its left, z up, table top at z = 0. Their hinge
opens to negative angles about -x; ours opens to positive ones about +x, which is the same motion.
Departures, each because the original is not physical (1 % of Earth's gravity, a flap of 3 kg, a
hinge in mid-air): real masses, a hinge with dry friction, two posts that carry it.
"""

from __future__ import annotations

import mujoco
import numpy as np

from skewmi.policy_io import Array
from skewmi.sim.arm.table import CONTACT, STIFF_FRICTION, STIFF_LIMIT, add_box

DOOR_HINGE = (0.02, -0.05, 0.075)
"""A point of the hinge line, which is parallel to x; world, m."""
DOOR_MAX = 1.52
"""Door angle at the open stop, rad."""
PANEL_MASS = 0.10
"""kg: 20 mm of foam-core board (130 kg/m^3). Slowly lifted, the handle weighs 2.3 N on the hand:
not more than what the arm may carry beside its gripper (0.5 kg less 0.25 kg)."""
HANDLE_MASS = 0.03
"""kg: as the printed handle of the other task, a third of it in the post."""
DOOR_FRICTIONLOSS = 0.10
"""Dry friction of the hinge, N m: more than the door's weight gives (0.074 at most, at 17
degrees), so that it stays wherever it is left."""
DOOR_DAMPING = 0.1
"""Viscous friction of the hinge, N m s/rad: the original's."""
DOOR_ARMATURE = 2e-4
"""Inertia of what turns in the hinge besides the door, kg m^2: as the lid's of the other task."""

FRAME_ORIGIN = (-0.08, 0.0, 0.0)
"""Origin of the body that carries the door: the middle of the flap's footprint. Moving or turning
this one body moves everything; world, m."""

# Low corner, high corner, world, m, door shut.
PANEL = ((-0.20, -0.08, 0.04), (0.04, 0.08, 0.06))
_HANDLE_POST = ((-0.135, 0.020, 0.060), (-0.125, 0.030, 0.095))
"""The original's begins inside the panel, 15 mm lower."""
_HINGE_POSTS = {
    "hinge_post_near": ((-0.215, -0.060, 0.0), (-0.205, -0.040, 0.085)),
    "hinge_post_far": ((0.045, -0.060, 0.0), (0.055, -0.040, 0.085)),
}
"""Ours: beyond both ends of the flap, where the hand does not come (its half is 35 mm along x)."""

HANDLE_BAR_CENTRE = (-0.08, 0.025, 0.09)
"""Centre of the handle's bar with the door shut, world, m."""
HANDLE_BAR_RADIUS = 0.005
HANDLE_BAR_LENGTH = 0.090
"""Along x. The end away from the robot is free: an L with the post."""

_BUMPER = {**STIFF_LIMIT, "solref_limit": (0.015, 1.0)}
"""The door meets rubber at both stops, as the lid of the other task does."""

_DARK = (0.30, 0.32, 0.35, 1.0)
_DOOR_GREEN = (0.30, 0.55, 0.42, 1.0)
_HANDLE_RED = (0.80, 0.22, 0.18, 1.0)


def add_parts(spec: mujoco.MjSpec) -> None:
    """Add the door and what carries it to a spec whose origin is the world's.

    Adds the joint `door_hinge` (rad, 0 shut, positive open).
    """
    frame = spec.worldbody.add_body(name="door_frame", pos=FRAME_ORIGIN)
    for name, corners in _HINGE_POSTS.items():
        add_box(frame, name, corners, _DARK, origin=FRAME_ORIGIN)

    door = frame.add_body(name="door", pos=np.subtract(DOOR_HINGE, FRAME_ORIGIN))
    door.add_joint(
        name="door_hinge",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=(1.0, 0.0, 0.0),
        range=(0.0, DOOR_MAX),
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        frictionloss=DOOR_FRICTIONLOSS,
        damping=[DOOR_DAMPING, 0.0, 0.0],
        armature=DOOR_ARMATURE,
        **STIFF_FRICTION,
        **_BUMPER,
    )
    add_box(door, "door_panel", PANEL, _DOOR_GREEN, origin=DOOR_HINGE, mass=PANEL_MASS)
    post = HANDLE_MASS / 3
    add_box(door, "handle_post", _HANDLE_POST, _HANDLE_RED, origin=DOOR_HINGE, mass=post)
    along_x = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)
    door.add_geom(
        name="handle_bar",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(HANDLE_BAR_RADIUS, HANDLE_BAR_LENGTH / 2, 0.0),
        pos=np.subtract(HANDLE_BAR_CENTRE, DOOR_HINGE),
        quat=along_x,
        rgba=_HANDLE_RED,
        mass=HANDLE_MASS - post,
        **CONTACT,
    )


def in_door(y: Array, z: Array, angle: Array) -> tuple[Array, Array]:
    """Where a point is as the door sees it: where it would be if the door were turned shut.

    Args:
        y, z: World, m. Shape (...).
        angle: Of the door, rad. Shape (...).

    Returns:
        World y and z of the point turned back by the angle about the hinge, m. Each shape (...).
    """
    _, hinge_y, hinge_z = DOOR_HINGE
    away, up = y - hinge_y, z - hinge_z
    cos, sin = np.cos(angle), np.sin(angle)
    return hinge_y + cos * away + sin * up, hinge_z - sin * away + cos * up
