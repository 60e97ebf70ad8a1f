"""A straight line of the hand as a path of the joints."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skewmi.deploy.motion.joint_path import JointPath, chebyshev_places
from skewmi.errors import KinematicsError
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import Array

NODES = 10
"""Places of a line at which inverse kinematics is asked."""
_REACHED = 1e-5
"""m, rad."""
_LARGEST_STEP = 0.6
"""Of a joint from one place to the next, rad: more is another posture, not the next place."""
_LOOKED_AT = 33
STRAIGHT = 5e-4
"""How far the hand may be off the line between those places, m."""


def hand_line(
    arm: ArmKinematics,
    q: Array,
    start: Array,
    end: Array,
    require: Callable[[Array], None] = lambda q: None,
) -> JointPath:
    """The joints' path for a straight line of the flange, its orientation kept.

    Args:
        arm: Whose hand.
        q: Configuration at (or next to) the start, rad. Shape (7,).
        start, end: Of the line, robot base frame, m. Shape (3,).
        require: Asked about every configuration found; raises for one that is not wanted.

    Returns:
        A path as long as the line, m.

    Raises:
        KinematicsError: The hand cannot follow it.
        SkewmiError: What `require` raises.
    """
    _, rotation = arm.forward(q)
    length = float(np.linalg.norm(end - start))
    rows: list[Array] = []
    for s in chebyshev_places(length, NODES):
        position = start + (s / length) * (end - start)
        result = arm.inverse(position, rotation, q, max_iterations=20)
        if result.position_error > _REACHED or result.rotation_error > _REACHED:
            raise KinematicsError(
                f"out of reach: the hand cannot go on straight after {1e3 * s:.0f} of "
                f"{1e3 * length:.0f} mm"
            )
        if rows and np.abs(result.q - q).max() > _LARGEST_STEP:
            raise KinematicsError(
                f"the arm would have to turn over after {1e3 * s:.0f} of {1e3 * length:.0f} mm"
            )
        q = result.q
        require(q)
        rows.append(q)
    path = JointPath.through(np.array(rows), length)
    _require_straight(arm, path, start, end)
    return path


def _require_straight(arm: ArmKinematics, path: JointPath, start: Array, end: Array) -> None:
    s = np.linspace(0.0, path.length, _LOOKED_AT)
    position, _ = arm.forward(path.at(s))
    off = position - start - (s / path.length)[:, None] * (end - start)
    largest = float(np.linalg.norm(off, axis=1).max())
    if largest > STRAIGHT:
        raise KinematicsError(
            f"the hand would leave the straight line by {1e3 * largest:.1f} mm: the arm is "
            "stretched, or at the end of a joint, there"
        )
