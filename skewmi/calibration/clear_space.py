"""Whether the right arm is clear of itself, the robot, the table and boxes, by the MuJoCo model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import cos, sin

import mujoco
import numpy as np

from skewmi.errors import ConfigurationError
from skewmi.robot_models import mjcf, yumi
from skewmi.robot_models.obstacle import Obstacle
from skewmi.trajectory import Array

CLEARANCE = 0.02
"""Smallest distance kept, m: what a deployed guard asks for (5 mm) and room for an arm that does
not follow its command exactly."""


class ClearSpace:
    """Distances of the right arm, the left one parked at home, fingers open.

    Args:
        obstacles: What stands around it besides robot and table.
        clearance: Smallest distance that counts as clear, m.
        inside: What else has to hold: configurations, rad, shape (n, 7) -> the first that is
            somewhere it must not be, and where; None if all may be where they are.
    """

    def __init__(
        self,
        obstacles: Sequence[Obstacle] = (),
        clearance: float = CLEARANCE,
        inside: Callable[[Array], tuple[int, str] | None] | None = None,
    ) -> None:
        if not 0.0 < clearance < 1.0:
            raise ConfigurationError(f"clearance is {clearance} m; it must be within 0..1 m")
        self._clearance, self._inside = clearance, inside
        spec = mjcf.build_robot(left_arm="parked", collision=True, visual=False)
        spec.worldbody.add_geom(
            name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(2.0, 2.0, 0.1)
        )
        for number, box in enumerate(obstacles):
            spec.worldbody.add_geom(
                name=f"obstacle_{number}",
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=box.centre,
                size=box.half_size,
                quat=(cos(box.yaw / 2.0), 0.0, 0.0, sin(box.yaw / 2.0)),
            )
        for geom in list(spec.geoms):
            # MuJoCo then reports pairs that near as contacts.
            geom.margin = clearance
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._link = np.array([self._link_of(int(b)) for b in self._model.geom_bodyid])
        self._torso = self._model.geom_bodyid == self._model.body(yumi.BODY_NAME).id
        self._qpos = [int(self._model.joint(n).qposadr[0]) for n in yumi.joint_names("right")]
        for name in yumi.finger_names("right"):
            self._data.qpos[int(self._model.joint(name).qposadr[0])] = yumi.GRIPPER.travel

    def first_touch(self, q: Array) -> tuple[int, str] | None:
        """The first configuration that is not clear, and what is too near what; None if all are.

        Args:
            q: rad, chain order. Shape (n, 7).
        """
        if self._inside is not None and (outside := self._inside(q)) is not None:
            return outside
        for index, row in enumerate(q):
            self._data.qpos[self._qpos] = row
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_comPos(self._model, self._data)
            mujoco.mj_collision(self._model, self._data)
            for contact in self._data.contact[: self._data.ncon]:
                first, second = map(int, contact.geom)
                if contact.dist < self._clearance and not self._built_together(first, second):
                    pair = f"{self._name(first)} and {self._name(second)}"
                    return index, f"{pair} are too near each other"
        return None

    def _built_together(self, first: int, second: int) -> bool:
        """Links one and two joints apart, and the first link, which turns in the torso."""
        near, far = sorted((first, second), key=lambda geom: self._link[geom])
        apart = self._link[far] - self._link[near]
        if self._link[near]:
            return bool(apart < 3)
        return bool(self._link[far] == 1 and self._torso[near])

    def _link_of(self, body: int) -> int:
        """Number of the right arm's link that a body is or is fixed to; 0 for all that stands."""
        name = self._model.body(body).name
        links = yumi.link_names("right")
        return links.index(name) + 1 if name in links else 7 * name.startswith("gripper_r_")

    def _name(self, geom: int) -> str:
        name: str = self._model.geom(geom).name
        return name or str(self._model.body(self._model.geom_bodyid[geom]).name)
