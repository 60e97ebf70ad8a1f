"""What stands on the table in OpenPressClose: box, lid with handle, button.

Geometry: the boxes of the Skew-Explore "yumi_door_button" scene of its
authors' published code (MIT), restated in world coordinates: x forward from the robot, y to its
left, z up, table top at z = 0.
Departures, each because the original is not physical (1 % of Earth's gravity, massless button):
handle posts 4 mm further out, real masses, hinge and slide held by dry friction.
"""

from __future__ import annotations

import mujoco
import numpy as np

from skewmi.sim.arm.table import STIFF_FRICTION, STIFF_LIMIT, add_box

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

HANDLE_BAR_CENTRE = (-0.009, -0.1395, 0.116)
"""Centre of the handle's bar with the lid shut, world, m."""

_BUMPER = {**STIFF_LIMIT, "solref_limit": (0.015, 1.0)}
"""The lid lands on rubber, which gives way by up to 1 mm: shut by a hand at 150 mm/s on the
stiffest of stops, the hand met peaks of 155 N; so it meets 100 N."""

_DARK = (0.30, 0.32, 0.35, 1.0)
_LID_BLUE = (0.25, 0.45, 0.70, 1.0)
_HANDLE_RED = (0.80, 0.22, 0.18, 1.0)
_BUTTON_YELLOW = (0.95, 0.75, 0.15, 1.0)


def add_parts(spec: mujoco.MjSpec) -> None:
    """Add box, lid and button to a spec whose origin is the world's.

    Adds the joints `lid_hinge` (rad, 0 shut, positive open) and `button_slide` (m, 0 up,
    positive pressed).
    """
    box = spec.worldbody.add_body(name="box", pos=BOX_ORIGIN)
    for name, corners in _WALLS.items():
        add_box(box, name, corners, _DARK, origin=BOX_ORIGIN)

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
        **STIFF_FRICTION,
        **_BUMPER,
    )
    add_box(lid, "lid_plate", _LID_PLATE, _LID_BLUE, origin=LID_HINGE, mass=LID_PLATE_MASS)
    for name, corners in _HANDLE.items():
        share = HANDLE_MASS / len(_HANDLE)
        add_box(lid, name, corners, _HANDLE_RED, origin=LID_HINGE, mass=share)

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
        **STIFF_FRICTION,
        **STIFF_LIMIT,
    )
    add_box(button, "button_plate", _BUTTON, _BUTTON_YELLOW, origin=button_centre, mass=BUTTON_MASS)
