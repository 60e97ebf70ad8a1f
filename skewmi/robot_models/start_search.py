"""Finds a good configuration for a task to start from; `yumi.TABLE_CONFIGURATION` is one.

    python -m skewmi.robot_models.start_search
    python -m skewmi.robot_models.start_search --start 0 -0.1 0.27 --low -0.05 -0.15 0.19 \\
        --high 0.05 0.1 0.33

The arm has one redundant degree of freedom and several branches, so a hand pose leaves a choice.
The search draws random configurations, solves each for the start pose, drives every solution on
straight lines to the eight corners of the hand's box and back in small steps (with the solution
itself as posture, as the tasks do), and rates the worst figures met:

    margin to the joint bounds / 25 deg,
    smallest singular value of the Jacobian (length unit 0.3 m) / 0.45,
    clearance of elbow and forearm to the table / 0.18 m,
    clearance of the arm to torso and left arm / 0.15 m.

The rating is the smallest of the four; the configuration rated best wins, and among equals the
one whose axis 4 is nearer to zero. The scales are about the best value of each alone, so that no
figure is bought at the expense of another.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from skewmi.errors import KinematicsError
from skewmi.robot_models import mjcf, yumi
from skewmi.robot_models.base_frame import NOMINAL_BASE, BaseFrame
from skewmi.robot_models.frames import BASE_IN_WORLD, HAND_DOWN, world_to_base
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.yumi import Array

LENGTH_UNIT = 0.3
"""Metres that count as one radian in the conditioning figure: about half the reach."""


Vector = tuple[float, float, float]


@dataclass(frozen=True)
class HandRoom:
    """Where the hand of a task starts, and the box it moves in; task world, m."""

    start: Vector
    low: Vector
    high: Vector


TABLE_ROOM = HandRoom((-0.009, -0.1345, 0.270), (-0.019, -0.155, 0.190), (0.001, 0.135, 0.355))
"""What `yumi.TABLE_CONFIGURATION` was found for."""


@dataclass(frozen=True)
class Rating:
    """Worst figures of configurations over the box. Every array has shape (n,).

    Attributes:
        reached: Whether every point was met within 0.01 mm and 0.001 deg.
        joint_margin: Smallest distance to a joint bound of the table, rad.
        singular_value: Smallest singular value of the Jacobian, length unit 0.3 m.
        table_clearance: Links 2..6 to the table, m.
        body_clearance: Links 3..7 and hand to torso and left arm, m.
    """

    reached: NDArray[np.bool_]
    joint_margin: Array
    singular_value: Array
    table_clearance: Array
    body_clearance: Array

    @property
    def score(self) -> Array:
        """Smallest of the four scaled figures; negative where the box is not reached."""
        figures = np.stack(
            [
                self.joint_margin / np.radians(25.0),
                self.singular_value / 0.45,
                self.table_clearance / 0.18,
                self.body_clearance / 0.15,
            ]
        )
        return np.where(self.reached, figures.min(axis=0), -1.0)


class Clearance:
    """Distances between parts of the robot and the table plane z = 0."""

    def __init__(self) -> None:
        spec = mjcf.build_robot(visual=False)
        spec.worldbody.add_geom(
            name="table",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(-BASE_IN_WORLD[0], 0.0, -0.01),
            size=(0.4, 0.5, 0.01),
        )
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        right = yumi.link_names("right")
        hand = "gripper_r_base"
        self._pairs = {
            "table": (self._geoms(right[1:6]), [self.model.geom("table").id]),
            "body": (
                self._geoms([*right[2:], hand]),
                self._geoms([yumi.BODY_NAME, *yumi.link_names("left"), "gripper_l_base"]),
            ),
        }

    def _geoms(self, bodies: Sequence[str]) -> list[int]:
        ids = {self.model.body(name).id for name in bodies}
        return [i for i in range(self.model.ngeom) if self.model.geom_bodyid[i] in ids]

    def distances(self, q: Array, *, horizon: float = 0.5) -> tuple[float, float]:
        """Distance to the table and to the body, m, at most `horizon`, for q of shape (7,)."""
        self.data.qpos[:7] = q
        mujoco.mj_kinematics(self.model, self.data)
        nearest = []
        for moving, fixed in self._pairs.values():
            found = horizon
            for first, second in itertools.product(moving, fixed):
                distance = mujoco.mj_geomDistance(self.model, self.data, first, second, found, None)
                found = min(found, distance)
            nearest.append(found)
        return nearest[0], nearest[1]


def joint_margin(q: Array) -> Array:
    """Distance to the nearest joint bound, rad. Shape (..., 7) -> (...)."""
    return np.asarray(np.minimum(q - yumi.POSITION_LOWER, yumi.POSITION_UPPER - q).min(axis=-1))


def smallest_singular_value(arm: ArmKinematics, q: Array) -> Array:
    """Of the Jacobian with lengths in units of `LENGTH_UNIT`. Shape (..., 7) -> (...)."""
    scale = np.array([1.0 / LENGTH_UNIT] * 3 + [1.0] * 3)[:, None]
    return np.asarray(np.linalg.svd(arm.jacobian(q) * scale, compute_uv=False)[..., -1])


def rate(
    q: Array,
    *,
    room: HandRoom = TABLE_ROOM,
    steps: int = 25,
    base: BaseFrame = NOMINAL_BASE,
    rotation: Array = HAND_DOWN,
) -> Rating:
    """Rate start configurations by driving each to the corners of the box.

    Args:
        q: Configurations with the hand at the start pose, rad. Shape (n, 7).
        room: Start and box.
        steps: Steps of each straight line.
        base: Where the robot is in the frame of start and box.
        rotation: Of the hand, to the robot base. Shape (3, 3).
    """
    arm, clearance = ArmKinematics("right"), Clearance()
    start = base.to_base(room.start)
    n = len(q)
    reached = np.ones(n, dtype=np.bool_)
    margin, singular = joint_margin(q), smallest_singular_value(arm, q)
    visited = [q]
    for corner_w in itertools.product(*zip(room.low, room.high, strict=True)):
        corner = base.to_base(corner_w)
        present = q
        for fraction in np.linspace(0.0, 1.0, steps + 1)[1:]:
            target = np.broadcast_to(start + fraction * (corner - start), (n, 3))
            result = arm.inverse(target, rotation, present, posture=q)
            present = result.q
            reached &= (result.position_error < 1e-5) & (result.rotation_error < np.radians(1e-3))
            margin = np.minimum(margin, joint_margin(present))
            singular = np.minimum(singular, smallest_singular_value(arm, present))
        visited.append(present)
    distances = np.full((n, 2), np.inf)
    for i in np.flatnonzero(reached):
        for configuration in visited:
            distances[i] = np.minimum(distances[i], clearance.distances(configuration[i]))
    return Rating(reached, margin, singular, distances[:, 0], distances[:, 1])


def solve_start(q_start: Array, room: HandRoom = TABLE_ROOM) -> Array:
    """Those of the configurations near `q_start` (n, 7) that put the hand at the start pose."""
    arm = ArmKinematics("right")
    target = world_to_base(room.start)
    result = arm.inverse(
        target,
        HAND_DOWN,
        q_start,
        max_iterations=150,
        position_tolerance=1e-10,
        rotation_tolerance=1e-10,
    )
    met = (result.position_error < 1e-9) & (result.rotation_error < 1e-9)
    return result.q[met]


def search(
    room: HandRoom = TABLE_ROOM, *, samples: int = 3000, refinements: int = 6, seed: int = 0
) -> tuple[Array, Rating]:
    """Best configuration found, shape (7,), and its rating.

    Raises:
        KinematicsError: None was found.
    """
    generator = np.random.default_rng(seed)
    arm = ArmKinematics("right")
    draws = generator.uniform(arm.position_lower, arm.position_upper, (samples, 7))
    candidates = solve_start(draws, room)
    decent = joint_margin(candidates) > np.radians(15.0)
    decent &= smallest_singular_value(arm, candidates) > 0.2
    candidates = candidates[decent]
    if not len(candidates):
        raise KinematicsError(f"no good configuration with the hand at {room.start} was found")
    best = candidates[np.argsort(-_preference(candidates, room))[:5]]
    spread = 0.2
    for _ in range(refinements):
        near = best[:, None] + generator.normal(0.0, spread, (len(best), 12, 7))
        candidates = np.concatenate([best, solve_start(near.reshape(-1, 7), room)])
        best = candidates[np.argsort(-_preference(candidates, room))[:5]]
        spread *= 0.5
    winner = best[:1]
    return winner[0], rate(winner, room=room)


def _preference(candidates: Array, room: HandRoom) -> Array:
    # Axis 4 turns by 580 degrees: the same pose comes twice, and less wound up is better.
    return rate(candidates, room=room).score - 1e-3 * np.abs(candidates[:, 4])


def main() -> None:
    """Print the winner in degrees and radians, and its figures."""
    parser = argparse.ArgumentParser(description="Start configuration for a box of the hand.")
    for name in ("start", "low", "high"):
        parser.add_argument(
            f"--{name}",
            nargs=3,
            type=float,
            default=getattr(TABLE_ROOM, name),
            metavar=("X", "Y", "Z"),
            help="task world, m",
        )
    options = parser.parse_args()
    room = HandRoom(tuple(options.start), tuple(options.low), tuple(options.high))
    q, rating = search(room)
    lines = [
        f"configuration, deg: {np.degrees(q).round(3).tolist()}",
        f"configuration, rad: {[float(f'{x:.12f}') for x in q]}",
        f"joint margin {np.degrees(rating.joint_margin[0]):.1f} deg, "
        f"singular value {rating.singular_value[0]:.3f}, "
        f"table {rating.table_clearance[0]:.3f} m, body {rating.body_clearance[0]:.3f} m, "
        f"score {rating.score[0]:.3f}",
    ]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
