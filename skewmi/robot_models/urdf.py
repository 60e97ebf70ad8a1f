"""The YuMi as URDF 1.2 text, from the table in `yumi`: for Pinocchio, Rerun and ROS tools.

Root link `yumi_body` is the robot base frame. Shapes are primitives only, so the text needs no
other file.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence

import numpy as np

from skewmi.errors import ConfigurationError
from skewmi.robot_models import shapes, yumi
from skewmi.robot_models.frames import rotation_about, rotation_from_rpy, rpy_from_rotation
from skewmi.robot_models.yumi import Inertial, Side, Vector

_ZERO: Vector = (0.0, 0.0, 0.0)


def build_urdf(*, arms: Sequence[Side] = yumi.ARMS, hooked: bool = True) -> str:
    """URDF of the body and the arms asked for; an arm left out is absent.

    Args:
        arms: Which arms, in the order their joints shall appear.
        hooked: Whether the right hand has the hooked fingers.

    Returns:
        Text with links and joints named as in the MJCF, and the flange frames `tool0_r` and
        `tool0_l` as links. The second finger of a hand mimics the first.

    Raises:
        ConfigurationError: No arm, or one twice.
        NotFoundError: An arm's name is unknown.
    """
    if not arms or len(set(arms)) != len(arms):
        raise ConfigurationError(
            f"arms is {list(arms)}; give each of {list(yumi.ARMS)} at most once"
        )
    robot = ET.Element("robot", name="yumi", version="1.2")
    for paint, colour in shapes.COLOURS.items():
        material = ET.SubElement(robot, "material", name=f"yumi_{paint}")
        ET.SubElement(material, "color", rgba=_numbers(colour))
    _add_link(robot, yumi.BODY_NAME, yumi.BODY_INERTIAL, shapes.BODY_VISUAL, shapes.BODY_COLLISION)
    for side in arms:
        _add_arm(robot, side, hooked=hooked and side == "right")
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode")


def _add_arm(robot: ET.Element, side: Side, *, hooked: bool) -> None:
    letter = yumi.suffix(side)
    a, b, c = yumi.ARM_BASE_XYZ_ANGLES[side]
    base_rotation = rotation_about(0, a) @ rotation_about(1, b) @ rotation_about(2, c)
    parent = yumi.BODY_NAME
    for i, (name, link) in enumerate(
        zip(yumi.joint_names(side), yumi.link_names(side), strict=True)
    ):
        origin = yumi.LINK_ORIGINS[i]
        position, rpy = origin.position, origin.rpy
        if i == 0:
            # URDF has no body for the arm base either: fold it into the first joint.
            moved = np.array(yumi.ARM_BASE_POSITION[side]) + base_rotation @ np.array(position)
            position = _vector(moved)
            rpy = _vector(rpy_from_rotation(base_rotation @ rotation_from_rpy(rpy)))
        limits = yumi.JOINT_RANGES[i]
        joint = _add_joint(robot, name, "revolute", parent, link, position, rpy, (0.0, 0.0, 1.0))
        _add_limit(joint, limits.lower, limits.upper, limits.velocity, yumi.JOINT_TORQUES[i])
        _add_link(
            robot, link, yumi.LINK_INERTIALS[i], shapes.LINK_VISUAL[i], shapes.LINK_COLLISION[i]
        )
        parent = link

    tool = yumi.tool_name(side)
    flange = yumi.FLANGE_ORIGIN
    _add_joint(robot, f"{tool}_joint", "fixed", parent, tool, flange.position, flange.rpy)
    ET.SubElement(robot, "link", name=tool)
    hand = f"gripper_{letter}_base"
    _add_joint(robot, f"{hand}_joint", "fixed", tool, hand, _ZERO, _ZERO)
    _add_link(robot, hand, yumi.GRIPPER.base, shapes.GRIPPER_VISUAL, shapes.GRIPPER_COLLISION)
    driving, following = yumi.finger_names(side)
    for sign, part, name in ((-1.0, "finger_r", driving), (1.0, "finger_l", following)):
        finger = f"gripper_{letter}_{part}"
        joint = _add_joint(
            robot,
            name,
            "prismatic",
            hand,
            finger,
            (0.0, 0.0, yumi.GRIPPER.finger_origin_z),
            _ZERO,
            (sign, 0.0, 0.0),
        )
        _add_limit(joint, 0.0, yumi.GRIPPER.travel, yumi.GRIPPER.speed, yumi.GRIPPER.force)
        if name == following:
            ET.SubElement(joint, "mimic", joint=driving, multiplier="1", offset="0")
        boxes = shapes.finger_shapes(sign, hooked=hooked and sign > 0)
        _add_link(robot, finger, shapes.finger_inertial(boxes), boxes, boxes)


def _add_joint(
    robot: ET.Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    position: Vector,
    rpy: Vector,
    axis: Vector | None = None,
) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "origin", xyz=_numbers(position), rpy=_numbers(rpy))
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    if axis is not None:
        ET.SubElement(joint, "axis", xyz=_numbers(axis))
    return joint


def _add_limit(
    joint: ET.Element, lower: float, upper: float, velocity: float, effort: float
) -> None:
    ET.SubElement(
        joint,
        "limit",
        lower=repr(lower),
        upper=repr(upper),
        velocity=repr(velocity),
        effort=repr(effort),
    )


def _add_link(
    robot: ET.Element,
    name: str,
    inertial: Inertial,
    visual: Iterable[shapes.Shape],
    collision: Iterable[shapes.Shape],
) -> None:
    link = ET.SubElement(robot, "link", name=name)
    element = ET.SubElement(link, "inertial")
    ET.SubElement(element, "origin", xyz=_numbers(inertial.centre), rpy="0 0 0")
    ET.SubElement(element, "mass", value=repr(inertial.mass))
    keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    values = (repr(float(value)) for value in inertial.inertia)
    ET.SubElement(element, "inertia", dict(zip(keys, values, strict=True)))
    for kind, group in (("visual", visual), ("collision", collision)):
        for shape in group:
            part = ET.SubElement(link, kind)
            _add_shape(part, shape)
            if kind == "visual":
                ET.SubElement(part, "material", name=f"yumi_{shape.paint}")


def _add_shape(part: ET.Element, shape: shapes.Shape) -> None:
    match shape:
        case shapes.Box():
            position, rpy = shape.centre, shape.rpy
            size = tuple(2.0 * half for half in shape.half_size)
            kind, attributes = "box", {"size": _numbers(size)}
        case shapes.Sphere():
            position, rpy = shape.centre, _ZERO
            kind, attributes = "sphere", {"radius": repr(shape.radius)}
        case shapes.Capsule() | shapes.Cylinder():
            start, end = np.array(shape.start), np.array(shape.end)
            position, rpy = _vector((start + end) / 2.0), _rpy_of_z(end - start)
            kind = "capsule" if isinstance(shape, shapes.Capsule) else "cylinder"
            length = float(np.linalg.norm(end - start))
            attributes = {"radius": repr(shape.radius), "length": repr(length)}
    ET.SubElement(part, "origin", xyz=_numbers(position), rpy=_numbers(rpy))
    ET.SubElement(ET.SubElement(part, "geometry"), kind, attributes)


def _rpy_of_z(direction: yumi.Array) -> Vector:
    """Roll, pitch, yaw of a frame whose z axis points along `direction`."""
    x, y, z = direction / np.linalg.norm(direction)
    # Rz(yaw) Ry(pitch) maps z to (cos yaw sin pitch, sin yaw sin pitch, cos pitch).
    return (0.0, float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x)))


def _vector(array: yumi.Array) -> Vector:
    x, y, z = array.tolist()
    return (x, y, z)


def _numbers(values: Iterable[float]) -> str:
    """Full precision: `repr` of a double reads back as the same double."""
    return " ".join(repr(float(value)) for value in values)
