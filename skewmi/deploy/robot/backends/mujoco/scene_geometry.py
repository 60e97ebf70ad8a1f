"""The geometry of a compiled scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from skewmi.deploy.wire.scene_geometry import SceneGeometry, SceneJoint, ScenePart
from skewmi.deploy.wire.simulation_status import ScenePose
from skewmi.robot_models.base_frame import NOMINAL_BASE, BaseFrame
from skewmi.robot_models.frames import quaternion_from_rotation, rotation_from_quaternion
from skewmi.trajectory import Array

_ROBOT_PREFIXES = ("yumi_", "gripper_")


_SAME = 1e-9
"""m: what stands no farther from where it is described stands there."""


@dataclass(frozen=True)
class Standing:
    """In whose frame a scene is described: in that of a box that is known to stand somewhere.

    The box and what moves with it are then where the nominal model has them; all else is where the
    robot is.

    Attributes:
        base: The robot base in that frame. In the model's world it is the nominal one.
        box_body: Body of the box; empty if there is none.
    """

    base: BaseFrame = NOMINAL_BASE
    box_body: str = ""

    @property
    def turn_wxyz(self) -> Array:
        """Of what does not move with the box, as a quaternion."""
        return quaternion_from_rotation(self.base.rotation)

    def moved(self, position: Array) -> Array:
        """Points of the model's world in the frame, m. Shape (3,)."""
        return self.base.to_task(NOMINAL_BASE.to_base(position))

    def stays(self, model: mujoco.MjModel, body: int) -> bool:
        """Whether a body is told where the nominal model has it."""
        if self.base == NOMINAL_BASE:
            return True
        return str(model.body(int(model.body_rootid[body])).name) == self.box_body


_NOMINAL = Standing()


def scene_geometry(
    model: mujoco.MjModel,
    fields: Mapping[str, str] | None = None,
    standing: Standing = _NOMINAL,
) -> SceneGeometry:
    """Everything in a compiled model that is not the robot.

    Shapes that are no boxes are described by the box around them; infinite planes are left
    out. A part moves with the nearest hinge or slide above it: joints in a chain are not
    described.

    Args:
        model: Robot and scene.
        fields: Observation field of each joint of the scene, by the joint's name.
        standing: In whose frame.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    mujoco.mj_kinematics(model, data)
    joints: dict[str, SceneJoint] = {}
    parts = []
    for geom in range(model.ngeom):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        body, is_robot = int(model.geom_bodyid[geom]), False
        joint = -1
        while body > 0:
            is_robot |= model.body(body).name.startswith(_ROBOT_PREFIXES)
            if joint < 0 and model.body_jntnum[body] == 1:
                joint = int(model.body_jntadr[body])
            body = int(model.body_parentid[body])
        if is_robot:
            continue
        if joint >= 0:
            name = model.joint(joint).name
            hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
            anchor, axis = data.xanchor[joint], data.xaxis[joint]
            if not standing.stays(model, int(model.jnt_bodyid[joint])):
                anchor, axis = standing.moved(anchor), standing.base.vectors_to_task(axis)
            joints[name] = SceneJoint(
                name,
                "hinge" if hinge else "slide",
                tuple(map(float, anchor)),
                tuple(map(float, axis)),
                (fields or {}).get(name, ""),
            )
        parts.append(_part(model, data, geom, joint, standing))
    return SceneGeometry(tuple(parts), tuple(joints.values()))


def scene_poses(
    model: mujoco.MjModel, nominal: mujoco.MjModel, standing: Standing = _NOMINAL
) -> tuple[ScenePose, ...]:
    """How the bodies that stand in the world are placed in one model, compared with another.

    Args:
        model: As it is.
        nominal: As it is described; the same bodies.
        standing: In whose frame it is described.

    Returns:
        One for each body that stands elsewhere, with all that it carries.
    """
    poses = []
    for body in np.flatnonzero(model.body_parentid == 0)[1:]:
        there, described = model.body_pos[body], nominal.body_pos[body]
        back, turn = np.empty(4), np.empty(4)
        mujoco.mju_negQuat(back, nominal.body_quat[body])
        mujoco.mju_mulQuat(turn, model.body_quat[body], back)
        turned = np.empty(3)
        if standing.base != NOMINAL_BASE:
            there, described, turn = _seen_from(standing, model, int(body), described, turn)
            if np.abs(there - described).max() <= _SAME:
                described = there
        mujoco.mju_rotVecQuat(turned, described, turn)
        if np.array_equal(there, described) and np.allclose(turn, (1.0, 0.0, 0.0, 0.0)):
            continue
        poses.append(
            ScenePose(
                tuple(_geom_name(model, geom) for geom in _carried(model, int(body))),
                tuple(map(float, there - turned)),
                tuple(map(float, turn)),
            )
        )
    return tuple(poses)


def _seen_from(
    standing: Standing, model: mujoco.MjModel, body: int, described: Array, turn: Array
) -> tuple[Array, Array, Array]:
    """Where a body is and is described to be, m, and how it is turned against that; in a frame.

    Args:
        standing: The frame.
        model: As it is.
        body: Which, one that stands in the world.
        described: Where the nominal model has it, m. Shape (3,).
        turn: From the nominal model to this one, wxyz. Shape (4,).
    """
    there = standing.moved(model.body_pos[body])
    base = standing.base.rotation
    rotation = base @ rotation_from_quaternion(turn)
    if not standing.stays(model, body):
        described, rotation = standing.moved(described), rotation @ base.T
    return there, described, quaternion_from_rotation(rotation)


def _carried(model: mujoco.MjModel, body: int) -> list[int]:
    """Geoms of a body that stands in the world, and of all bodies above it in the tree."""
    return [int(geom) for geom in np.flatnonzero(model.body_rootid[model.geom_bodyid] == body)]


def _geom_name(model: mujoco.MjModel, geom: int) -> str:
    return model.geom(geom).name or f"geom_{geom}"


def _part(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, joint: int, standing: Standing
) -> ScenePart:
    quaternion = np.empty(4)
    rotation = data.geom_xmat[geom]
    mujoco.mju_mat2Quat(quaternion, rotation)
    centre, half_size = model.geom_aabb[geom][:3], model.geom_aabb[geom][3:]
    position = data.geom_xpos[geom] + rotation.reshape(3, 3) @ centre
    if not standing.stays(model, int(model.geom_bodyid[geom])):
        position = standing.moved(position)
        mujoco.mju_mulQuat(quaternion, standing.turn_wxyz, quaternion.copy())
    return ScenePart(
        name=_geom_name(model, geom),
        joint=model.joint(joint).name if joint >= 0 else "",
        half_size=tuple(map(float, half_size)),
        position=tuple(map(float, position)),
        quaternion_wxyz=tuple(map(float, quaternion)),
        colour=tuple(map(float, model.geom_rgba[geom])),
    )
