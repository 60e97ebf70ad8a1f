"""Boxes and joints of a scene as plain data, so that a recording can be drawn without it.

A robot server that knows its scene describes it; the recorder keeps the description; replay draws
the boxes and moves them by the recorded scene joints.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import mujoco
import numpy as np

from skewmi.errors import ConfigurationError

Vector = tuple[float, ...]

_ROBOT_PREFIXES = ("yumi_", "gripper_")


@dataclass(frozen=True)
class ScenePart:
    """One box, where it is while all scene joints are zero."""

    name: str
    joint: str
    """Scene joint that moves it; empty if it never moves."""
    half_size: Vector
    """m. Three numbers."""
    position: Vector
    """Centre in world, m. Three numbers."""
    quaternion_wxyz: Vector
    """Orientation in world. Four numbers."""
    colour: Vector
    """Red, green, blue, alpha, each 0..1."""


@dataclass(frozen=True)
class SceneJoint:
    """A hinge or slide of the scene."""

    name: str
    kind: str
    """"hinge" (rad) or "slide" (m)."""
    anchor: Vector
    """A point of the axis in world, m."""
    axis: Vector
    """Unit vector in world."""
    field: str = ""
    """Observation field that the joint's position is; empty if the task does not observe it."""


@dataclass(frozen=True)
class SceneGeometry:
    """What replay draws beside the robot."""

    parts: tuple[ScenePart, ...]
    joints: tuple[SceneJoint, ...]

    def to_json(self) -> str:
        """Inverse of `from_json`."""
        return json.dumps(asdict(self), separators=(",", ":"))

    @staticmethod
    def from_json(text: str) -> SceneGeometry:
        """Read a description.

        Raises:
            ConfigurationError: It is not one.
        """
        try:
            content = json.loads(text)
            return SceneGeometry(
                tuple(ScenePart(**_tuples(part)) for part in content["parts"]),
                tuple(SceneJoint(**_tuples(joint)) for joint in content["joints"]),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ConfigurationError(f"not a scene description: {error}") from error

    @staticmethod
    def from_model(model: mujoco.MjModel, fields: Mapping[str, str] | None = None) -> SceneGeometry:
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


def _part(model: mujoco.MjModel, data: mujoco.MjData, geom: int, joint: int) -> ScenePart:
    quaternion = np.empty(4)
    rotation = data.geom_xmat[geom]
    mujoco.mju_mat2Quat(quaternion, rotation)
    centre, half_size = model.geom_aabb[geom][:3], model.geom_aabb[geom][3:]
    return ScenePart(
        name=model.geom(geom).name or f"geom_{geom}",
        joint=model.joint(joint).name if joint >= 0 else "",
        half_size=tuple(map(float, half_size)),
        position=tuple(map(float, data.geom_xpos[geom] + rotation.reshape(3, 3) @ centre)),
        quaternion_wxyz=tuple(map(float, quaternion)),
        colour=tuple(map(float, model.geom_rgba[geom])),
    )


def _tuples(content: dict[str, Any]) -> dict[str, Any]:
    return {k: tuple(v) if isinstance(v, list) else v for k, v in content.items()}
