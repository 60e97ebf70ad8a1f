"""How far the arm is from itself, the robot, the table and obstacles, at every sample of a chunk.

Distances are dear (hundreds of pairs of shapes), so they are computed only when they may matter. A
joint i that turns by d moves no point of link p by more than r_ip d, r_ip being the largest
distance of a point of that link from its axis; and only the joints between two links change the
distance of the two. If a distance at some earlier configuration q0 exceeds the clearance by more
than sum_i r_ip |q_i - q0_i| over those joints, it exceeds it at q too: nothing need be computed.
Otherwise the pairs for which this fails are measured at the sample itself.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import coal
import numpy as np
import pinocchio
from numpy.typing import NDArray

from skewmi.errors import LimitViolationError
from skewmi.robot_models.frames import rotation_about
from skewmi.robot_models.obstacle import Obstacle
from skewmi.trajectory import Array

TABLE_THICKNESS = 0.2

SLACK = 1e-4
"""How much nearer still what is too near already may come, m: a line of the hand is exact to a
tenth of that."""


class ClearanceCheck:
    """Watches the distances of one arm's links; everything else stands still.

    Args:
        model: Of the arm alone, in Pinocchio.
        data: Of the model, and used by whoever shares it.
        shapes: Of the whole robot, on that model; the table is added.
        torso: Names of the shapes that the first link turns in.
        clearance: Smallest distance that is allowed, m.
        obstacles: What else stands there.
    """

    def __init__(
        self,
        model: Any,
        data: Any,
        shapes: Any,
        torso: set[str],
        clearance: float,
        obstacles: Iterable[Obstacle] = (),
    ) -> None:
        self._model, self._data, self._shapes = model, data, shapes
        self._clearance = clearance
        self._add_table()
        self._add_obstacles(obstacles)
        self._add_pairs(torso)
        self._shape_data = pinocchio.GeometryData(self._shapes)
        self._required = np.full(len(self._group), clearance)
        """Of each pair, m."""
        self._measure_at(np.zeros(model.nq))

    def permit_leaving(self, q: Array) -> None:
        """Let the arm out of where it stands too near something, however it got there.

        From now on two shapes that are nearer to each other at `q` than the clearance may be as
        near as that, but not nearer (by more than `SLACK`); all others keep the clearance.

        Args:
            q: Where the arm rests, rad. Shape (7,).
        """
        distances = self._measure(q)
        near = distances < self._clearance
        self._required = np.where(near, distances - SLACK, self._clearance)

    def check(self, q: Array) -> float:
        """Accept configurations or raise.

        Args:
            q: rad. Shape (n, 7).

        Returns:
            Lower bound of the smallest distance over all of them, m.

        Raises:
            LimitViolationError: Names the two shapes that are too near each other.
        """
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
            too_near = distances < self._required[near]
            if too_near.any():
                worst = int(np.argmin(np.where(too_near, distances, np.inf)))
                pair = self._shapes.collisionPairs[int(near[worst])]
                first, second = (
                    self._shapes.geometryObjects[i].name for i in (pair.first, pair.second)
                )
                required = float(self._required[near[worst]])
                raise LimitViolationError(
                    "clearance, m", float(distances[worst]), required, f"{first} to {second}"
                )
        return clearance

    def distances(self, q: Array) -> list[tuple[str, str, float]]:
        """All pairs that are watched, nearest first, with their distance in m."""
        values = self._measure(q)
        objects = self._shapes.geometryObjects
        found = [
            (objects[pair.first].name, objects[pair.second].name, float(value))
            for pair, value in zip(self._shapes.collisionPairs, values, strict=True)
        ]
        return sorted(found, key=lambda entry: entry[2])

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
        self._shapes.addGeometryObject(table)

    def _add_obstacles(self, obstacles: Iterable[Obstacle]) -> None:
        for number, box in enumerate(obstacles):
            shape = pinocchio.GeometryObject(
                box.name or f"obstacle {number}",
                0,
                pinocchio.SE3(rotation_about(2, box.yaw), np.array(box.centre)),
                coal.Box(*(2.0 * half for half in box.half_size)),
            )
            self._shapes.addGeometryObject(shape)

    def _add_pairs(self, torso: set[str]) -> None:
        """Right arm against the left one, torso, table and obstacles, and against itself.

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
