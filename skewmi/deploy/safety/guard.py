"""A second opinion on every chunk: Pinocchio on the URDF, independent of mink's MuJoCo model.

Checked are the hand's position and tilt, torque (inverse dynamics) and mobility at a few samples,
and the distances of the arm to the robot itself and to the table at all of them.

Distances are dear (hundreds of pairs of shapes), so they are computed only when they may matter. A
joint i that turns by d moves no point of link p by more than r_ip d, r_ip being the largest
distance of a point of that link from its axis; and only the joints between two links change the
distance of the two. If a distance at some earlier configuration q0 exceeds the clearance by more
than sum_i r_ip |q_i - q0_i| over those joints, it exceeds it at q too: nothing need be computed.
Otherwise the pairs for which this fails are measured at the sample itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
import pinocchio
from numpy.typing import NDArray

from skewmi.errors import LimitViolationError
from skewmi.policy_io import Workspace
from skewmi.robot_models import urdf, yumi
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import Array

CLEARANCE = 0.005
"""Smallest distance to the robot itself and the table, m; at home the modelled torso and elbow
are 8 mm apart."""

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

TABLE_THICKNESS = 0.2


@dataclass(frozen=True)
class GuardReport:
    """What a chunk comes to at worst."""

    clearance: float
    """To the robot itself and the table, m."""
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
    """

    def __init__(
        self,
        limits: JointLimits,
        workspace: Workspace | None = None,
        *,
        payload: float = 0.0,
        clearance: float = CLEARANCE,
    ) -> None:
        self._torque = limits.torque
        self._clearance = clearance
        self._workspace: tuple[Array, Array, Array] | None = None
        opening = yumi.GRIPPER.travel
        if workspace is not None:
            base = np.array(workspace.base_position)
            w, x, y, z = workspace.hand_quaternion_wxyz
            rotation = pinocchio.Quaternion(w, x, y, z).normalized().toRotationMatrix()
            low, high = np.array(workspace.low) - base, np.array(workspace.high) - base
            self._workspace = low, high, rotation
            opening = workspace.gripper_opening
        text = urdf.build_urdf()
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
        self._model, self._shapes = pinocchio.buildReducedModel(full, shapes, locked, fixed)
        assert tuple(self._model.names)[1:] == arm
        if payload > 0.0:
            tip = pinocchio.SE3(np.eye(3), np.array([0.0, 0.0, 0.136]))
            frame = self._model.frames[self._model.getFrameId(yumi.tool_name("right"))]
            added = pinocchio.Inertia(payload, np.zeros(3), np.zeros((3, 3)))
            self._model.appendBodyToJoint(frame.parentJoint, added, frame.placement * tip)
        self._data = self._model.createData()
        self._tool = self._model.getFrameId(yumi.tool_name("right"))
        self._add_table()
        self._add_pairs(torso)
        self._shape_data = pinocchio.GeometryData(self._shapes)
        self._measure_at(np.zeros(7))
        self._weights = np.array([1.0, 1.0, 1.0, LEVER, LEVER, LEVER])[:, None]

    def check(self, q: Array, v: Array, a: Array, new_samples: int = 5) -> GuardReport:
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
            clearance=self._check_clearance(q),
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

    def distances(self, q: Array) -> list[tuple[str, str, float]]:
        """All pairs that are watched, nearest first, with their distance in m."""
        values = self._measure(q)
        objects = self._shapes.geometryObjects
        found = [
            (objects[pair.first].name, objects[pair.second].name, float(value))
            for pair, value in zip(self._shapes.collisionPairs, values, strict=True)
        ]
        return sorted(found, key=lambda entry: entry[2])

    def _check_hand(self, q: Array) -> tuple[float, float]:
        if self._workspace is None:
            return 0.0, 0.0
        low, high, rotation = self._workspace
        position, actual = self.tool(q)
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

    def _check_clearance(self, q: Array) -> float:
        """Lower bound of the smallest distance over all samples."""
        bound = self._bounds(q)
        if bound.min() <= self._clearance:
            self._measure_at(q[0])
            bound = self._bounds(q)
        if bound.min() > self._clearance:
            return float(bound.min())
        clearance = np.inf
        for sample, bounds in zip(q, bound, strict=True):
            close = bounds <= self._clearance
            near = np.flatnonzero(close[self._group])
            distances = self._measure(sample, near)
            far = float(bounds[~close].min(initial=np.inf))
            clearance = min(clearance, far, float(distances.min(initial=np.inf)))
            if clearance < self._clearance:
                pair = self._shapes.collisionPairs[int(near[int(np.argmin(distances))])]
                first, second = (
                    self._shapes.geometryObjects[i].name for i in (pair.first, pair.second)
                )
                raise LimitViolationError(
                    "clearance, m", clearance, self._clearance, f"{first} to {second}"
                )
        return clearance

    def _bounds(self, q: Array) -> Array:
        """What the distances of each group of pairs are at least, m. Shapes (n, 7), (n, groups)."""
        bounds: Array = self._nearest - np.abs(q - self._measured_at) @ self._reach.T
        return bounds

    def _measure_at(self, q: Array) -> None:
        """Measure every pair at a configuration, to know what others can come to at worst."""
        self._measured_at = q.copy()
        self._nearest = np.full(len(self._reach), np.inf)
        np.minimum.at(self._nearest, self._group, self._measure(q))

    def _measure(self, q: Array, pairs: NDArray[np.intp] | None = None) -> Array:
        """Distances of the given pairs (all by default) at a configuration, m."""
        pinocchio.updateGeometryPlacements(
            self._model, self._data, self._shapes, self._shape_data, q
        )
        if pairs is None:
            pinocchio.computeDistances(self._shapes, self._shape_data)
            pairs = np.arange(len(self._shapes.collisionPairs))
        else:
            for index in pairs:
                pinocchio.computeDistance(self._shapes, self._shape_data, int(index))
        results = self._shape_data.distanceResults
        return np.array([results[int(index)].min_distance for index in pairs])

    def _reaches(self) -> Array:
        """r: how far a point of each link can be from each joint's axis, m; 0 for joints behind.

        Shape (8, 7): links 0 (fixed) to 7, joints 1 to 7.
        """
        reach = np.zeros((8, 7))
        for shape in self._shapes.geometryObjects:
            link = int(shape.parentJoint)
            shape.geometry.computeLocalAABB()
            length = shape.geometry.aabb_radius + float(
                np.linalg.norm(shape.placement.act(shape.geometry.aabb_center))
            )
            for i in range(link, 0, -1):
                reach[link, i - 1] = max(reach[link, i - 1], length)
                length += float(np.linalg.norm(self._model.jointPlacements[i].translation))
        return reach

    def _add_table(self) -> None:
        table = pinocchio.GeometryObject(
            "table",
            0,
            pinocchio.SE3(np.eye(3), np.array([0.0, 0.0, -TABLE_THICKNESS / 2.0])),
            coal.Box(4.0, 4.0, TABLE_THICKNESS),
        )
        self._table = self._shapes.addGeometryObject(table)

    def _add_pairs(self, torso: set[str]) -> None:
        """Right arm against the left one, torso and table, and against itself.

        Left out is what touches by construction: links one and two joints apart, and the first
        link, which turns in the torso.
        """
        shapes, reaches = list(self._shapes.geometryObjects), self._reaches()
        groups: dict[tuple[int, int], int] = {}
        group: list[int] = []
        for i, first in enumerate(shapes):
            for j, second in enumerate(shapes[:i]):
                fixed, moved = sorted((first, second), key=lambda shape: int(shape.parentJoint))
                near, far = int(fixed.parentJoint), int(moved.parentJoint)
                built_together = far - near < 3 if near else far == 1 and fixed.name in torso
                if far and not built_together:
                    self._shapes.addCollisionPair(pinocchio.CollisionPair(j, i))
                    group.append(groups.setdefault((near, far), len(groups)))
        # Pairs of the same two links have the same bounds.
        self._group = np.array(group)
        between = [np.arange(1, 8) > near for near, _ in groups]
        self._reach = np.array([reaches[far] for _, far in groups]) * between
