"""The geometry of a compiled scene."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from skewmi.deploy.wire.scene_geometry import SceneGeometry, SceneJoint, ScenePart
from skewmi.deploy.wire.simulation_status import ScenePose

_ROBOT_PREFIXES = ("yumi_", "gripper_")


def scene_geometry(model: mujoco.MjModel, fields: Mapping[str, str] | None = None) -> SceneGeometry:
    """Everything in a compiled model that is not the robot.

    Shapes that are no boxes are described by the box around them; infinite planes are left
    out. A part moves with the nearest hinge or slide above it: joints in a chain are not
    described.

    Args:
        model: Robot and scene.
        fields: Observation field of each joint of the scene, by the joint's name.
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
            joints[name] = SceneJoint(
                name,
                "hinge" if hinge else "slide",
                tuple(map(float, data.xanchor[joint])),
                tuple(map(float, data.xaxis[joint])),
                (fields or {}).get(name, ""),
            )
        parts.append(_part(model, data, geom, joint))
    return SceneGeometry(tuple(parts), tuple(joints.values()))


def scene_poses(model: mujoco.MjModel, nominal: mujoco.MjModel) -> tuple[ScenePose, ...]:
    """How the bodies that stand in the world are placed in one model, compared with another.

    Args:
        model: As it is.
        nominal: As it is described; the same bodies.

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


def _carried(model: mujoco.MjModel, body: int) -> list[int]:
    """Geoms of a body that stands in the world, and of all bodies above it in the tree."""
    return [int(geom) for geom in np.flatnonzero(model.body_rootid[model.geom_bodyid] == body)]


def _geom_name(model: mujoco.MjModel, geom: int) -> str:
    return model.geom(geom).name or f"geom_{geom}"


def _part(model: mujoco.MjModel, data: mujoco.MjData, geom: int, joint: int) -> ScenePart:
    quaternion = np.empty(4)
    rotation = data.geom_xmat[geom]
    mujoco.mju_mat2Quat(quaternion, rotation)
    centre, half_size = model.geom_aabb[geom][:3], model.geom_aabb[geom][3:]
    return ScenePart(
        name=_geom_name(model, geom),
        joint=model.joint(joint).name if joint >= 0 else "",
        half_size=tuple(map(float, half_size)),
        position=tuple(map(float, data.geom_xpos[geom] + rotation.reshape(3, 3) @ centre)),
        quaternion_wxyz=tuple(map(float, quaternion)),
        colour=tuple(map(float, model.geom_rgba[geom])),
    )
