"""What the YuMi looks like and what it collides with: primitives drawn by us, in link frames.

Proportions follow photographs and cross-sections measured on the coarse link meshes published with
github.com/kth-ros-pkg/yumi (no mesh is used). Collision capsules were fitted to overlap those
volumes best and then grown by 2 mm; they stay within about a centimetre of them. Both arms have
the same links. Lengths in m.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from skewmi.robot_models import yumi
from skewmi.robot_models.yumi import Inertial, Vector

Paint = Literal["white", "light", "grey", "dark", "black"]

COLOURS: dict[Paint, tuple[float, float, float, float]] = {
    "white": (0.93, 0.93, 0.92, 1.0),
    "light": (0.78, 0.79, 0.80, 1.0),
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
    # Foot, its two prongs (as one plate), its shoulders.
    Box((-0.177, 0.0, -0.020), (0.180, 0.192, 0.080)),
    Box((0.064, 0.0, 0.020), (0.072, 0.186, 0.028)),
    Capsule((-0.300, 0.130, 0.040), (-0.095, 0.130, 0.040), 0.055),
    Capsule((-0.300, -0.130, 0.040), (-0.095, -0.130, 0.040), 0.055),
    # Column.
    Box((-0.242, 0.0, 0.235), (0.119, 0.117, 0.185)),
    # Shoulder block, up to where the arms start.
    Box((-0.190, 0.0, 0.390), (0.160, 0.050, 0.080)),
    Capsule((-0.278, 0.045, 0.390), (-0.040, 0.045, 0.390), 0.081),
    Capsule((-0.278, -0.045, 0.390), (-0.040, -0.045, 0.390), 0.081),
    Capsule((0.005, -0.045, 0.385), (0.005, 0.045, 0.385), 0.078),
)

LINK_COLLISION: tuple[tuple[Shape, ...], ...] = (
    (
        Capsule((0.004, -0.046, 0.069), (-0.026, 0.002, 0.018), 0.037),
        Capsule((0.023, -0.042, 0.105), (0.037, -0.042, 0.095), 0.050),
        Capsule((0.007, 0.027, 0.015), (0.019, -0.026, 0.023), 0.035),
    ),
    (
        Capsule((0.001, -0.001, -0.040), (-0.017, 0.023, -0.031), 0.052),
        Capsule((-0.031, 0.106, -0.002), (-0.029, 0.138, -0.000), 0.056),
        Capsule((0.016, 0.002, -0.017), (-0.008, -0.016, -0.019), 0.040),
    ),
    (
        Capsule((-0.016, -0.042, 0.082), (0.016, -0.010, 0.017), 0.035),
        Capsule((-0.009, 0.014, 0.010), (-0.036, -0.054, 0.057), 0.033),
        Capsule((-0.040, -0.039, 0.091), (-0.053, -0.040, 0.074), 0.043),
    ),
    (
        Capsule((0.038, 0.085, -0.002), (0.038, 0.131, -0.001), 0.048),
        Capsule((0.037, 0.032, -0.019), (0.057, 0.140, -0.003), 0.034),
        Capsule((0.009, 0.006, -0.032), (-0.000, -0.000, -0.030), 0.054),
    ),
    (
        Capsule((-0.017, -0.019, 0.017), (0.005, 0.017, 0.010), 0.026),
        Capsule((0.018, -0.020, 0.013), (-0.028, -0.047, 0.067), 0.027),
        Capsule((-0.028, -0.046, 0.106), (0.003, -0.044, 0.053), 0.031),
    ),
    (
        Capsule((-0.001, 0.000, 0.000), (0.024, 0.002, -0.014), 0.037),
        Capsule((0.039, 0.004, -0.003), (0.030, -0.036, -0.005), 0.033),
        Capsule((0.004, -0.027, -0.005), (0.005, -0.002, -0.030), 0.040),
    ),
    (Capsule((0.0, 0.0, -0.004), (0.0, 0.0, -0.003), 0.0315),),
)

GRIPPER_COLLISION: tuple[Shape, ...] = (Box((0.0, 0.0, 0.042), (0.0416, 0.0345, 0.042)),)

BODY_VISUAL: tuple[Shape, ...] = (
    # Foot: a plinth, a rounded upper part and two prongs towards the table.
    Box((-0.178, 0.0, -0.070), (0.166, 0.150, 0.030), "grey"),
    Box((-0.178, 0.0, -0.040), (0.172, 0.165, 0.020), "grey"),
    Box((-0.178, 0.0, 0.002), (0.177, 0.188, 0.024)),
    Capsule((-0.300, 0.135, 0.030), (-0.055, 0.135, 0.026), 0.053),
    Capsule((-0.300, -0.135, 0.030), (-0.055, -0.135, 0.026), 0.053),
    Box((-0.190, 0.0, 0.040), (0.162, 0.132, 0.036)),
    Box((0.030, 0.137, 0.009), (0.085, 0.046, 0.021)),
    Cylinder((0.114, 0.112, -0.012), (0.114, 0.112, 0.0294), 0.0206),
    Cylinder((0.114, 0.162, -0.012), (0.114, 0.162, 0.0294), 0.0206),
    Box((0.122, 0.137, 0.009), (0.0122, 0.025, 0.0202)),
    Box((0.030, -0.137, 0.009), (0.085, 0.046, 0.021)),
    Cylinder((0.114, -0.112, -0.012), (0.114, -0.112, 0.0294), 0.0206),
    Cylinder((0.114, -0.162, -0.012), (0.114, -0.162, 0.0294), 0.0206),
    Box((0.122, -0.137, 0.009), (0.0122, 0.025, 0.0202)),
    # Column with rounded edges.
    Box((-0.245, 0.0, 0.185), (0.075, 0.1086, 0.130)),
    Cylinder((-0.170, 0.062, 0.050), (-0.170, 0.062, 0.330), 0.047),
    Cylinder((-0.170, -0.062, 0.050), (-0.170, -0.062, 0.330), 0.047),
    Box((-0.170, 0.0, 0.190), (0.0465, 0.062, 0.135)),
    Cylinder((-0.318, 0.070, 0.050), (-0.318, 0.070, 0.410), 0.041),
    Cylinder((-0.318, -0.070, 0.050), (-0.318, -0.070, 0.410), 0.041),
    Box((-0.318, 0.0, 0.235), (0.0405, 0.070, 0.180)),
    # Shoulders: two rounded beams side by side, and a collar for each arm.
    Capsule((-0.281, 0.048, 0.392), (-0.030, 0.048, 0.392), 0.078),
    Capsule((-0.281, -0.048, 0.392), (-0.030, -0.048, 0.392), 0.078),
    Box((-0.155, 0.0, 0.392), (0.150, 0.060, 0.0775)),
    Cylinder((-0.036, 0.035, 0.363), (0.026, 0.061, 0.399), 0.062),
    Cylinder((-0.036, -0.035, 0.363), (0.026, -0.061, 0.399), 0.062),
    Sphere((-0.012, 0.0, 0.375), 0.072),
)

_SEAM = 0.0015  # how far a dark seam between two links stays behind their surfaces

LINK_VISUAL: tuple[tuple[Shape, ...], ...] = (
    (
        Cylinder((0.0, 0.0, -0.034), (0.0, 0.0, -0.029), 0.0605 - _SEAM, "dark"),
        Cylinder((0.0, 0.0, -0.029), (0.0, 0.0, 0.006), 0.0605),
        Sphere((0.0, 0.0, 0.006), 0.0603),
        Capsule((0.004, -0.012, 0.020), (0.028, -0.040, 0.088), 0.045),
        Cylinder((0.030, -0.076, 0.100), (0.030, -0.010, 0.100), 0.0485),
        Cylinder((0.030, -0.0785, 0.100), (0.030, -0.070, 0.100), 0.042, "light"),
    ),
    (
        Cylinder((0.0, 0.0, 0.0065), (0.0, 0.0, 0.010), 0.0478 - _SEAM, "dark"),
        Cylinder((0.0, 0.0, -0.076), (0.0, 0.0, 0.0065), 0.0478),
        Cylinder((0.0, 0.0, -0.0785), (0.0, 0.0, -0.070), 0.041, "light"),
        Capsule((-0.006, 0.012, -0.034), (-0.028, 0.082, -0.004), 0.042),
        Capsule((-0.030, 0.085, 0.0), (-0.030, 0.120, 0.0), 0.0485),
        Cylinder((-0.030, 0.118, 0.0), (-0.030, 0.168, 0.0), 0.0535),
        Sphere((-0.030, 0.118, 0.0), 0.0535),
        Cylinder((-0.030, 0.168, 0.0), (-0.030, 0.1735, 0.0), 0.0495, "dark"),
    ),
    (
        Cylinder((0.0, 0.0, 0.0006), (0.0, 0.0, 0.013), 0.048),
        Sphere((0.0, 0.0, 0.012), 0.0478),
        Capsule((-0.002, -0.006, 0.018), (-0.037, -0.040, 0.072), 0.038),
        Cylinder((-0.0405, -0.0765, 0.0787), (-0.0405, -0.0095, 0.0787), 0.0475),
        Cylinder((-0.0405, -0.0788, 0.0787), (-0.0405, -0.070, 0.0787), 0.041, "light"),
    ),
    (
        Cylinder((0.0, 0.0, 0.0065), (0.0, 0.0, 0.0095), 0.0472 - _SEAM, "dark"),
        Cylinder((0.0, 0.0, -0.0755), (0.0, 0.0, 0.0065), 0.0472),
        Cylinder((0.0, 0.0, -0.078), (0.0, 0.0, -0.070), 0.0405, "light"),
        Capsule((0.006, 0.012, -0.034), (0.038, 0.080, -0.004), 0.037),
        Capsule((0.0405, 0.080, 0.0), (0.0405, 0.112, 0.0), 0.042),
        Cylinder((0.0405, 0.112, 0.0), (0.0405, 0.160, 0.0), 0.0455),
        Sphere((0.0405, 0.112, 0.0), 0.0455),
        Cylinder((0.0405, 0.160, 0.0), (0.0405, 0.1655, 0.0), 0.042, "dark"),
    ),
    (
        Cylinder((0.0, 0.0, 0.0008), (0.0, 0.0, 0.010), 0.041),
        Sphere((0.0, 0.0, 0.009), 0.0408),
        Capsule((-0.001, -0.008, 0.014), (-0.024, -0.043, 0.090), 0.0315),
        Cylinder((-0.027, -0.068, 0.1004), (-0.027, -0.029, 0.1004), 0.0335),
        Cylinder((-0.027, -0.0702, 0.1004), (-0.027, -0.060, 0.1004), 0.028, "light"),
    ),
    (
        Cylinder((0.0, 0.0, 0.022), (0.0, 0.0, 0.0285), 0.033 - _SEAM, "dark"),
        Cylinder((0.0, 0.0, -0.0645), (0.0, 0.0, 0.022), 0.033),
        Cylinder((0.0, 0.0, -0.067), (0.0, 0.0, -0.060), 0.0275, "light"),
        Capsule((0.006, -0.006, -0.010), (0.026, -0.024, -0.004), 0.031),
        Capsule((0.027, -0.030, -0.003), (0.027, -0.008, -0.003), 0.0325),
        Cylinder((0.027, -0.012, 0.0), (0.027, 0.024, 0.0), 0.0325),
        Cylinder((0.027, 0.024, 0.0), (0.027, 0.029, 0.0), 0.0325 - _SEAM, "dark"),
    ),
    (Cylinder((0.0, 0.0, -0.001), (0.0, 0.0, 0.007), 0.0315),),
)

GRIPPER_VISUAL: tuple[Shape, ...] = (
    # The housing has rounded sides: two cylinders and what lies between them.
    Cylinder((0.0, 0.0, 0.0005), (0.0, 0.0, 0.008), 0.034, "dark"),
    Cylinder((0.0085, 0.0, 0.008), (0.0085, 0.0, 0.064), 0.033),
    Cylinder((-0.0085, 0.0, 0.008), (-0.0085, 0.0, 0.064), 0.033),
    Box((0.0, 0.0, 0.036), (0.0085, 0.033, 0.028)),
    Box((0.0, 0.0, 0.070), (0.037, 0.024, 0.008), "grey"),
    Box((0.0, 0.0, 0.080), (0.034, 0.014, 0.004), "dark"),
)


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


def untested_pairs(side: yumi.Side) -> tuple[tuple[str, str], ...]:
    """Pairs of bodies that collision checks leave out, by name.

    Neighbours along the chain and links two apart overlap by construction (the torso and the
    shoulder link among them). The fingers never meet: their coupling keeps them apart, and the
    servo stops where the hook touches the other finger.
    """
    letter = yumi.suffix(side)
    hand, fingers = (
        f"gripper_{letter}_base",
        (f"gripper_{letter}_finger_r", f"gripper_{letter}_finger_l"),
    )
    chain = (yumi.BODY_NAME, *yumi.link_names(side), hand)
    pairs = [*pairwise(chain), *zip(chain, chain[2:], strict=False)]
    pairs += [(other, finger) for finger in fingers for other in (hand, chain[-2])]
    return (*pairs, fingers)
