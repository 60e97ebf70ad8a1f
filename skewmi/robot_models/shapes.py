"""What the YuMi looks like and what it collides with: primitives drawn by us, in link frames.

Proportions follow the boxes around ABB's links (`yumi-facts` of the mesh bounding boxes published
with OREBRO) and photographs; both arms have the same links. Lengths in m.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from skewmi.robot_models import yumi
from skewmi.robot_models.yumi import Inertial, Vector

Paint = Literal["white", "grey", "dark", "black"]

COLOURS: dict[Paint, tuple[float, float, float, float]] = {
    "white": (0.93, 0.93, 0.92, 1.0),
    "grey": (0.62, 0.64, 0.66, 1.0),
    "dark": (0.30, 0.31, 0.33, 1.0),
    "black": (0.10, 0.10, 0.11, 1.0),
}


@dataclass(frozen=True)
class Box:
    """A box, turned by rpy about its centre."""

    centre: Vector
    half_size: Vector
    paint: Paint = "white"
    rpy: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Capsule:
    """All points within `radius` of the segment from `start` to `end`."""

    start: Vector
    end: Vector
    radius: float
    paint: Paint = "white"


@dataclass(frozen=True)
class Cylinder:
    """A cylinder with flat ends at `start` and `end`."""

    start: Vector
    end: Vector
    radius: float
    paint: Paint = "white"


@dataclass(frozen=True)
class Sphere:
    """A ball."""

    centre: Vector
    radius: float
    paint: Paint = "white"


Shape = Box | Capsule | Cylinder | Sphere

BODY_COLLISION: tuple[Shape, ...] = (
    Box((-0.177, 0.0, -0.020), (0.180, 0.198, 0.082)),
    Box((0.064, 0.0, 0.020), (0.072, 0.186, 0.030)),
    Box((-0.242, 0.0, 0.18), (0.120, 0.112, 0.125)),
    Box((-0.210, 0.0, 0.383), (0.152, 0.128, 0.088)),
    Capsule((-0.015, -0.055, 0.395), (-0.015, 0.055, 0.395), 0.078),
    Capsule((0.010, -0.050, 0.37), (0.010, 0.050, 0.37), 0.075),
)

LINK_COLLISION: tuple[tuple[Shape, ...], ...] = (
    (
        Capsule((0.0, 0.0, 0.02), (0.012, -0.004, 0.075), 0.060),
        Capsule((0.03, -0.03, 0.10), (0.03, 0.012, 0.10), 0.049),
    ),
    (
        Capsule((0.0, 0.0, -0.03), (0.0, 0.0, 0.006), 0.048),
        Capsule((-0.03, 0.03, -0.012), (-0.03, 0.12, -0.012), 0.055),
    ),
    (
        Capsule((0.0, 0.0, 0.0), (-0.005, 0.0, 0.06), 0.047),
        Capsule((-0.0405, -0.031, 0.0787), (-0.0405, 0.0, 0.0787), 0.048),
    ),
    (
        Capsule((0.0, 0.0, -0.03), (0.0, 0.0, 0.0), 0.048),
        Capsule((0.0405, 0.03, -0.015), (0.0405, 0.12, -0.015), 0.046),
    ),
    (
        Capsule((0.0, 0.0, 0.006), (-0.005, -0.01, 0.06), 0.041),
        Capsule((-0.027, -0.036, 0.10039), (-0.027, 0.008, 0.10039), 0.033),
    ),
    (
        Capsule((0.0, 0.0, -0.034), (0.0, 0.0, -0.006), 0.033),
        Capsule((0.027, -0.034, -0.005), (0.027, 0.0, -0.005), 0.034),
    ),
    (Cylinder((0.0, 0.0, -0.031), (0.0, 0.0, 0.007), 0.0315),),
)

GRIPPER_COLLISION: tuple[Shape, ...] = (Box((0.0, 0.0, 0.042), (0.0416, 0.0345, 0.042)),)

BODY_VISUAL = BODY_COLLISION
LINK_VISUAL = LINK_COLLISION
GRIPPER_VISUAL: tuple[Shape, ...] = (Box((0.0, 0.0, 0.042), (0.0416, 0.0345, 0.042), "grey"),)


def finger_shapes(sign: float, *, hooked: bool) -> tuple[Box, ...]:
    """Boxes of one finger in its frame (origin on the flange's axis, closed faces at x = 0).

    Args:
        sign: +1 for the finger on the +x side of the hand, -1 for the other.
        hooked: Whether it has a hook at the tip, reaching over x = 0 to the other finger.
    """
    width, depth, length = yumi.GRIPPER.finger_size
    finger = Box((sign * width / 2, 0.0, length / 2), (width / 2, depth / 2, length / 2), "black")
    if not hooked:
        return (finger,)
    reach, height = yumi.GRIPPER.hook_length, yumi.GRIPPER.hook_height
    hook = Box(
        (-sign * reach / 2, 0.0, length - height / 2), (reach / 2, depth / 2, height / 2), "black"
    )
    return (finger, hook)


def finger_inertial(boxes: Iterable[Box]) -> Inertial:
    """Mass properties of a finger made of boxes with the density of a straight finger."""
    density = yumi.GRIPPER.finger_mass / float(np.prod(yumi.GRIPPER.finger_size))
    parts = [(density * 8.0 * float(np.prod(box.half_size)), box) for box in boxes]
    mass = sum(part for part, _ in parts)
    centre = np.sum([part * np.array(box.centre) for part, box in parts], axis=0) / mass
    inertia = np.zeros((3, 3))
    for part, box in parts:
        square = np.array(box.half_size) ** 2
        arm = np.array(box.centre) - centre
        inertia += part / 3.0 * (square.sum() * np.eye(3) - np.diag(square))
        inertia += part * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    xx, yy, zz = np.diag(inertia).tolist()
    xy, xz, yz = inertia[0, 1], inertia[0, 2], inertia[1, 2]
    x, y, z = (float(value) for value in centre)
    return Inertial(mass, (x, y, z), (xx, yy, zz, float(xy), float(xz), float(yz)))
