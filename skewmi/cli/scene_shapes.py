"""The box of a scene as calibration wants it, from the shapes that a robot server describes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skewmi.calibration.scene_faces import Face, Part, faces_of
from skewmi.deploy.safety.obstacles import TABLE_TOP
from skewmi.deploy.wire.scene_geometry import SceneGeometry, ScenePart
from skewmi.robot_models.frames import BASE_IN_WORLD, rotation_from_quaternion
from skewmi.robot_models.obstacle import Obstacle
from skewmi.sim import tasks


@dataclass(frozen=True, eq=False)
class SceneBox:
    """What stands on the table, where it is believed to stand.

    Attributes:
        standing: Parts that do not move.
        moving: Parts that do, where they are at rest.
        lid: Name of the first hinge; empty if there is none.
    """

    standing: Sequence[Part]
    moving: Sequence[Part]
    lid: str

    @property
    def faces(self) -> dict[str, Face]:
        """By name.

        Raises:
            ConfigurationError: Nothing stands there.
        """
        return faces_of(self.standing)

    @property
    def obstacles(self) -> list[Obstacle]:
        """Each part by itself."""
        return [_obstacle(part) for part in (*self.standing, *self.moving)]

    @staticmethod
    def of(scene: str) -> SceneBox:
        """From a description's `scene`.

        Raises:
            ConfigurationError: It is not one.
        """
        geometry = SceneGeometry.from_json(scene)
        boxes = [(shape.joint, _part(shape)) for shape in geometry.parts]
        boxes = [(joint, part) for joint, part in boxes if part.high[2] > TABLE_TOP]
        hinges = [joint.name for joint in geometry.joints if joint.kind == "hinge"]
        return SceneBox(
            [part for joint, part in boxes if not joint],
            [part for joint, part in boxes if joint],
            hinges[0] if hinges else "",
        )


def nominal_box() -> SceneBox:
    """Of the default task, without a robot."""
    from skewmi.deploy.robot.backends.mujoco.scene_geometry import scene_geometry
    from skewmi.sim.arm.scene import ArmScene

    arm = tasks.find(tasks.default()).arm
    assert arm is not None
    return SceneBox.of(scene_geometry(ArmScene(arm).model).to_json())


def _part(shape: ScenePart) -> Part:
    """The box around a shape, its sides along the base's axes."""
    half = np.abs(rotation_from_quaternion(shape.quaternion_wxyz)) @ np.array(shape.half_size)
    centre = np.array(shape.position) - BASE_IN_WORLD
    (x, y, z), (high_x, high_y, high_z) = (centre - half).tolist(), (centre + half).tolist()
    return Part(shape.name, (x, y, z), (high_x, high_y, high_z))


def _obstacle(part: Part) -> Obstacle:
    low, high = np.array(part.low), np.array(part.high)
    x, y, z = ((low + high) / 2.0).tolist()
    half_x, half_y, half_z = ((high - low) / 2.0).tolist()
    return Obstacle((x, y, z), (half_x, half_y, half_z), name=part.name)
