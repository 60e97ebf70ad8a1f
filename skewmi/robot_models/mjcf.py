"""The YuMi as a MuJoCo model, built from the table in `yumi` with `mujoco.MjSpec`.

The spec's world frame is the robot base frame unless `base_position` says otherwise. Visual geoms
are in group 2 and take no part in contacts; collision geoms are in group 3, unseen by default.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

import mujoco
import numpy as np

from skewmi.errors import ConfigurationError
from skewmi.robot_models import shapes, yumi
from skewmi.robot_models.frames import (
    quaternion_from_rotation,
    rotation_about,
    rotation_from_rpy,
)
from skewmi.robot_models.servo import ServoParameters
from skewmi.robot_models.yumi import FrameOrigin, Inertial, Side, Vector

Fingers = Literal["hooked", "straight"]
LeftArm = Literal["parked", "jointed", "absent"]

VISUAL_GROUP = 2
COLLISION_GROUP = 3


def build_robot(
    *,
    fingers: Fingers = "hooked",
    left_arm: LeftArm = "parked",
    collision: bool = True,
    visual: bool = True,
    base_position: Vector = (0.0, 0.0, 0.0),
) -> mujoco.MjSpec:
    """The robot without actuators.

    Args:
        fingers: Of the right hand: the paper's hooked pair or a straight one. The left hand
            always has straight fingers.
        left_arm: `parked` makes it static geometry at ABB's home pose, `jointed` moves,
            `absent` leaves it out.
        collision: Whether there are collision geoms and contact exclusions.
        visual: Whether there are visual geoms.
        base_position: Origin of the robot base frame in the spec's world, m.

    Returns:
        An uncompiled spec with right arm joints in chain order, then the two finger joints
        (coupled by an equality), and sites `tool0_r`, `tool0_l` at the flanges.

    Raises:
        ConfigurationError: An option is not one of those above.
    """
    _require("fingers", fingers, ("hooked", "straight"))
    _require("left_arm", left_arm, ("parked", "jointed", "absent"))
    spec = mujoco.MjSpec()
    spec.modelname = "yumi"
    spec.compiler.degree = False
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for paint, colour in shapes.COLOURS.items():
        spec.add_material(name=f"yumi_{paint}", rgba=colour, specular=0.3, shininess=0.4)

    body = spec.worldbody.add_body(name=yumi.BODY_NAME, pos=base_position)
    _set_inertial(body, yumi.BODY_INERTIAL)
    _add_shapes(
        body, shapes.BODY_VISUAL if visual else (), shapes.BODY_COLLISION if collision else ()
    )
    _add_arm(
        spec,
        body,
        "right",
        jointed=True,
        hooked=fingers == "hooked",
        visual=visual,
        collision=collision,
    )
    if left_arm != "absent":
        _add_arm(
            spec,
            body,
            "left",
            jointed=left_arm == "jointed",
            hooked=False,
            visual=visual,
            collision=collision,
        )
    return spec


def add_position_servos(
    spec: mujoco.MjSpec, parameters: ServoParameters, *, side: Side = "right"
) -> None:
    """Add a position servo per joint, one for the fingers, friction and gravity compensation.

    Actuators are named as the joints they drive; the gripper's is `gripper_r_joint` (the other
    finger follows by the equality). Controls are joint positions, rad, and finger travel, m.
    Gravity on arm and hand is compensated as a passive force, so it uses up no servo torque.
    """
    names = yumi.joint_names(side)
    for i, name in enumerate(names):
        joint = spec.joint(name)
        joint.armature = parameters.armature[i]
        joint.frictionloss = parameters.frictionloss[i]
        _add_servo(
            spec, name, parameters.kp[i], parameters.kd[i], parameters.force_limit[i], joint.range
        )
    driving, following = yumi.finger_names(side)
    for name in (driving, following):
        joint = spec.joint(name)
        # The one motor's inertia and damping, shared by the two fingers it moves.
        joint.armature = parameters.finger_armature / 2
        joint.damping[0] = parameters.finger_damping / 2
        joint.frictionloss = parameters.finger_frictionloss
    _add_servo(
        spec,
        driving,
        parameters.finger_kp,
        0.0,
        parameters.finger_force_limit,
        (parameters.finger_lowest_command, yumi.GRIPPER.travel),
    )
    letter = yumi.suffix(side)
    moving = {*yumi.link_names(side), *(f"gripper_{letter}_{part}" for part in _GRIPPER_PARTS)}
    for body in spec.bodies:
        if body.name in moving:
            body.gravcomp = 1.0


_GRIPPER_PARTS = ("base", "finger_r", "finger_l")


def _add_servo(
    spec: mujoco.MjSpec, name: str, kp: float, kd: float, limit: float, control_range: Any
) -> None:
    actuator = spec.add_actuator(
        name=name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        target=name,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
    )
    actuator.gainprm[0] = kp
    actuator.biasprm[1] = -kp
    actuator.biasprm[2] = -kd
    actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    actuator.forcerange = (-limit, limit)
    actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
    actuator.ctrlrange = np.array(control_range)


def _add_arm(
    spec: mujoco.MjSpec,
    body: Any,
    side: Side,
    *,
    jointed: bool,
    hooked: bool,
    visual: bool,
    collision: bool,
) -> None:
    # The arm base is folded into the pose of link 1: the model has no body for it.
    a, b, c = yumi.ARM_BASE_XYZ_ANGLES[side]
    rotation = rotation_about(0, a) @ rotation_about(1, b) @ rotation_about(2, c)
    position = np.array(yumi.ARM_BASE_POSITION[side])
    parent = body
    for i, name in enumerate(yumi.link_names(side)):
        origin = yumi.LINK_ORIGINS[i]
        position = position + rotation @ np.array(origin.position)
        rotation = rotation @ rotation_from_rpy(origin.rpy)
        if not jointed:
            rotation = rotation @ rotation_about(2, yumi.HOME[side][i])
        parent = parent.add_body(name=name, pos=position, quat=quaternion_from_rotation(rotation))
        position, rotation = np.zeros(3), np.eye(3)
        _set_inertial(parent, yumi.LINK_INERTIALS[i])
        if jointed:
            limits = yumi.JOINT_RANGES[i]
            parent.add_joint(
                name=yumi.joint_names(side)[i],
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=(0.0, 0.0, 1.0),
                range=(limits.lower, limits.upper),
                limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            )
        _add_shapes(
            parent,
            shapes.LINK_VISUAL[i] if visual else (),
            shapes.LINK_COLLISION[i] if collision else (),
        )
    _add_gripper(spec, parent, side, jointed, hooked, visual, collision)
    if collision:
        for first, second in shapes.untested_pairs(side):
            spec.add_exclude(name=f"{first}-{second}", bodyname1=first, bodyname2=second)


def _add_gripper(
    spec: mujoco.MjSpec,
    parent: Any,
    side: Side,
    jointed: bool,
    hooked: bool,
    visual: bool,
    collision: bool,
) -> None:
    letter = yumi.suffix(side)
    flange = yumi.FLANGE_ORIGIN
    hand = parent.add_body(
        name=f"gripper_{letter}_base", pos=flange.position, quat=_quaternion(flange)
    )
    hand.add_site(name=yumi.tool_name(side), size=(0.005, 0.005, 0.005), group=4)
    _set_inertial(hand, yumi.GRIPPER.base)
    _add_shapes(
        hand,
        shapes.GRIPPER_VISUAL if visual else (),
        shapes.GRIPPER_COLLISION if collision else (),
    )
    for sign, part, joint_name in zip(
        (-1.0, 1.0), ("finger_r", "finger_l"), yumi.finger_names(side), strict=True
    ):
        finger = hand.add_body(
            name=f"gripper_{letter}_{part}", pos=(0.0, 0.0, yumi.GRIPPER.finger_origin_z)
        )
        boxes = shapes.finger_shapes(sign, hooked=hooked and sign > 0)
        _set_inertial(finger, shapes.finger_inertial(boxes))
        if jointed:
            finger.add_joint(
                name=joint_name,
                type=mujoco.mjtJoint.mjJNT_SLIDE,
                axis=(sign, 0.0, 0.0),
                range=(0.0, yumi.GRIPPER.travel),
                limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            )
        _add_shapes(finger, boxes if visual else (), boxes if collision else ())
    if jointed:
        driving, following = yumi.finger_names(side)
        equality = spec.add_equality(
            name=f"gripper_{letter}_coupling",
            type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            name1=following,
            name2=driving,
        )
        equality.data[:5] = (0.0, 1.0, 0.0, 0.0, 0.0)
        # A rack and pinion is stiff: with the default impedance light fingers would slip apart
        # by millimetres under a few newtons.
        equality.solref[:2] = (0.01, 1.0)
        equality.solimp[:3] = (0.9999, 0.9999, 0.001)


def _set_inertial(body: Any, inertial: Inertial) -> None:
    body.explicitinertial = True
    body.mass = inertial.mass
    body.ipos = inertial.centre
    body.fullinertia = inertial.inertia


def _add_shapes(
    body: Any, visual: Iterable[shapes.Shape], collision: Iterable[shapes.Shape]
) -> None:
    for shape in visual:
        geom = _add_geom(body, shape)
        geom.group = VISUAL_GROUP
        geom.contype = 0
        geom.conaffinity = 0
        geom.material = f"yumi_{shape.paint}"
    for shape in collision:
        geom = _add_geom(body, shape)
        geom.group = COLLISION_GROUP
        geom.rgba = (0.9, 0.4, 0.2, 0.4)


def _add_geom(body: Any, shape: shapes.Shape) -> Any:
    # Masses come from the table alone.
    geom = body.add_geom(mass=0.0)
    match shape:
        case shapes.Box():
            geom.type = mujoco.mjtGeom.mjGEOM_BOX
            geom.pos, geom.size = shape.centre, shape.half_size
            geom.quat = quaternion_from_rotation(rotation_from_rpy(shape.rpy))
        case shapes.Sphere():
            geom.type = mujoco.mjtGeom.mjGEOM_SPHERE
            geom.pos, geom.size = shape.centre, (shape.radius, 0.0, 0.0)
        case shapes.Capsule() | shapes.Cylinder():
            capsule = isinstance(shape, shapes.Capsule)
            geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE if capsule else mujoco.mjtGeom.mjGEOM_CYLINDER
            geom.fromto = (*shape.start, *shape.end)
            geom.size = (shape.radius, 0.0, 0.0)
    return geom


def _quaternion(origin: FrameOrigin) -> yumi.Array:
    return quaternion_from_rotation(rotation_from_rpy(origin.rpy))


def _require(option: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise ConfigurationError(f"{option} is {value!r}; it must be one of {', '.join(allowed)}")
