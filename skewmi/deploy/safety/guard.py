"""A second opinion on every chunk: Pinocchio on the URDF, independent of mink's MuJoCo model.

Checked are the hand's position and tilt, torque (inverse dynamics) and mobility at a few samples,
and the distances of the arm to the robot itself, the table and obstacles at all of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pinocchio

from skewmi.deploy.safety.clearance import ClearanceCheck
from skewmi.errors import LimitViolationError
from skewmi.policy_io import Workspace
from skewmi.robot_models import urdf, yumi
from skewmi.robot_models.base_frame import BaseFrame, box_from_base
from skewmi.robot_models.limits import JointLimits
from skewmi.robot_models.obstacle import Obstacle
from skewmi.trajectory import CYCLE_TICKS, Array

CLEARANCE = 0.005
"""Smallest distance to the robot itself, table and obstacles, m; at home the modelled torso and
elbow are 8 mm apart."""

SINGULAR_VALUE = 0.02
"""Smallest singular value of the Jacobian (metres, and radians times `LEVER`) at which the arm
still counts as mobile: 1 rad/s in some joints then moves the hand by 20 mm/s only."""

LEVER = 0.3
"""Metres that a radian of hand rotation counts as."""

TILT = 0.1
"""Largest angle between the hand and its constant orientation, rad."""

WORKSPACE_TOLERANCE = 0.006
"""How far the hand may be outside of its box, m. A little more than the chunk checker's, so that
the difference of two correct models is not a breach."""

FEW_SAMPLES = 6
"""Samples of a chunk, spread evenly, at which hand and torque are looked at."""


@dataclass(frozen=True)
class GuardReport:
    """What a chunk comes to at worst."""

    clearance: float
    """To the robot itself, the table and obstacles, m."""
    torque: float
    """Fraction of the limit."""
    singular_value: float
    """Smallest; see `SINGULAR_VALUE`."""
    tilt: float
    """rad; zero without a workspace."""
    outside: float
    """m; negative inside of the box, zero without a workspace."""


class Guard:
    """Checks chunks of the right arm; the left one is parked at home.

    Args:
        limits: For their torques.
        workspace: Box and orientation of the hand, or None for motion outside of it.
        payload: Mass in the hand besides the gripper, kg, at the finger tips.
        clearance: m.
        obstacles: What stands before the robot, besides the table.
    """

    def __init__(
        self,
        limits: JointLimits,
        workspace: Workspace | None = None,
        *,
        payload: float = 0.0,
        clearance: float = CLEARANCE,
        obstacles: Iterable[Obstacle] = (),
    ) -> None:
        self._torque = limits.torque
        self._workspace: tuple[Array, Array, Array, BaseFrame] | None = None
        opening = yumi.GRIPPER.travel
        if workspace is not None:
            low, high, base = box_from_base(workspace)
            w, x, y, z = workspace.hand_quaternion_wxyz
            rotation = pinocchio.Quaternion(w, x, y, z).normalized().toRotationMatrix()
            self._workspace = low, high, rotation, base
            opening = workspace.gripper_opening
        self._model, shapes, torso = _build_arm(opening, payload)
        self._data = self._model.createData()
        self._tool = self._model.getFrameId(yumi.tool_name("right"))
        self.clearance = ClearanceCheck(
            self._model, self._data, shapes, torso, clearance, obstacles
        )
        self._weights = np.array([1.0, 1.0, 1.0, LEVER, LEVER, LEVER])[:, None]

    def check(self, q: Array, v: Array, a: Array, new_samples: int = CYCLE_TICKS) -> GuardReport:
        """Accept a chunk or raise.

        Args:
            q: Positions, rad. Shape (n, 7).
            v: Velocities, rad/s. Shape (n, 7).
            a: Accelerations, rad/s^2. Shape (n, 7).
            new_samples: Index of the sample at which the next chunk starts.

        Raises:
            LimitViolationError: Names what is broken.
        """
        if not all(np.isfinite(x).all() for x in (q, v, a)):
            raise LimitViolationError("finite numbers", float("nan"), 0.0)
        last = len(q) - 1
        few = sorted({round(k * last / (FEW_SAMPLES - 1)) for k in range(FEW_SAMPLES)})
        torque = max(self._check_torque(q[k], v[k], a[k]) for k in few)
        hand = [self._check_hand(q[k]) for k in few]
        value = min(self._check_mobility(q[k]) for k in {min(new_samples, len(q) - 1), len(q) - 1})
        return GuardReport(
            clearance=self.clearance.check(q),
            torque=torque,
            singular_value=value,
            tilt=max(tilt for _, tilt in hand),
            outside=max(outside for outside, _ in hand),
        )

    def tool(self, q: Array) -> tuple[Array, Array]:
        """Position (3,) and rotation (3, 3) of the flange in the robot base frame."""
        pinocchio.forwardKinematics(self._model, self._data, q)
        pose = pinocchio.updateFramePlacement(self._model, self._data, self._tool)
        return pose.translation.copy(), pose.rotation.copy()

    def _check_hand(self, q: Array) -> tuple[float, float]:
        if self._workspace is None:
            return 0.0, 0.0
        low, high, rotation, base = self._workspace
        position, actual = self.tool(q)
        position, actual = base.vectors_to_task(position), base.rotations_to_task(actual)
        outside = float(np.maximum(low - position, position - high).max())
        if outside > WORKSPACE_TOLERANCE:
            raise LimitViolationError(
                "distance outside the workspace, m", outside, WORKSPACE_TOLERANCE, "guard"
            )
        tilt = float(np.linalg.norm(pinocchio.log3(rotation.T @ actual)))
        if tilt > TILT:
            raise LimitViolationError("tilt of the hand, rad", tilt, TILT, "guard")
        return outside, tilt

    def _check_torque(self, q: Array, v: Array, a: Array) -> float:
        use = np.abs(pinocchio.rnea(self._model, self._data, q, v, a)) / self._torque
        joint = int(np.argmax(use))
        if use[joint] > 1.0:
            limit = float(self._torque[joint])
            raise LimitViolationError(
                "joint torque, N m", float(use[joint]) * limit, limit, f"joint index {joint}"
            )
        return float(use[joint])

    def _check_mobility(self, q: Array) -> float:
        jacobian = pinocchio.computeFrameJacobian(
            self._model, self._data, q, self._tool, pinocchio.LOCAL_WORLD_ALIGNED
        )
        value = float(np.linalg.svd(self._weights * jacobian, compute_uv=False)[-1])
        # Without a workspace the way may lead past a singular posture: joint motion does not mind.
        if self._workspace is not None and value < SINGULAR_VALUE:
            raise LimitViolationError("smallest singular value", value, SINGULAR_VALUE)
        return value


@cache
def _urdf_text() -> str:
    return urdf.build_urdf()


def _build_arm(opening: float, payload: float) -> tuple[Any, Any, set[str]]:
    """The right arm of the URDF with the left one parked, and every shape on it.

    Args:
        opening: Of the fingers, m.
        payload: At the finger tips, kg.

    Returns:
        Model and shapes, and the names of the shapes that were fixed to the body from the first.
    """
    text = _urdf_text()
    full = pinocchio.buildModelFromXML(text)
    shapes = pinocchio.buildGeomFromUrdfString(full, text, pinocchio.GeometryType.COLLISION)
    fixed = pinocchio.neutral(full)
    for name, value in zip(yumi.joint_names("left"), yumi.HOME["left"], strict=True):
        fixed[full.joints[full.getJointId(name)].idx_q] = value
    for side in yumi.ARMS:
        for name in yumi.finger_names(side):
            fixed[full.joints[full.getJointId(name)].idx_q] = opening
    torso = {shape.name for shape in shapes.geometryObjects if shape.parentJoint == 0}
    arm = yumi.joint_names("right")
    locked = [i for i in range(1, full.njoints) if full.names[i] not in arm]
    model, shapes = pinocchio.buildReducedModel(full, shapes, locked, fixed)
    assert tuple(model.names)[1:] == arm
    if payload > 0.0:
        tip = pinocchio.SE3(np.eye(3), np.array([0.0, 0.0, 0.136]))
        frame = model.frames[model.getFrameId(yumi.tool_name("right"))]
        added = pinocchio.Inertia(payload, np.zeros(3), np.zeros((3, 3)))
        model.appendBodyToJoint(frame.parentJoint, added, frame.placement * tip)
    return model, shapes, torso
