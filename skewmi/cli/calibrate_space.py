"""The space that a robot server gives to calibration, for who plans motion in it."""

from __future__ import annotations

import numpy as np

from skewmi.calibration.clear_space import ClearSpace
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.safety.flange_space import CALIBRATION, lowest_of_hand
from skewmi.deploy.session.open_space import open_space
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import Array

MARGIN = 0.002
"""Kept to the sides of the flange's space, m."""


def clear_space(described: RobotDescription, limits: JointLimits) -> ClearSpace:
    """Clear of robot, table and scene, and inside the calibration workspace.

    Raises:
        ConfigurationError: The robot server gives none.
    """
    offered = open_space(described, CALIBRATION, limits)
    space = offered.space
    forward = ArmKinematics("right").forward
    low, high = np.array(space.low) + MARGIN, np.array(space.high) - MARGIN

    def first_outside(q: Array) -> tuple[int, str] | None:
        position, rotation = forward(q)
        beyond = np.maximum(low - position, position - high).max(axis=1)
        too_low = lowest_of_hand(position, rotation) < space.fingers_above + MARGIN
        rows = np.flatnonzero((beyond > 0.0) | too_low)
        if not rows.size:
            return None
        row = int(rows[0])
        what = "leaves" if beyond[row] > 0.0 else "comes too low in"
        return row, f"the hand {what} the workspace {space.name!r}"

    return ClearSpace(offered.obstacles, inside=first_outside)
