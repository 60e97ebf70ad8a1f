"""What the hand may do in space, derived from what the joints may do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skewmi.errors import ConfigurationError
from skewmi.policy_io import Workspace
from skewmi.robot_models.base_frame import BaseFrame
from skewmi.robot_models.frames import rotation_from_quaternion
from skewmi.robot_models.kinematics import ArmKinematics, require_converged
from skewmi.robot_models.limits import JointLimits

MAX_ACCELERATION = 2.5
"""Per axis, m/s^2; a quarter of what ABB's data sheet gives for the tool."""

MAX_JERK = 40.0
"""Per axis, m/s^3: the acceleration is reached in 60 ms. With more, a stop at full speed has too
much of its acceleration above 10 Hz."""

SHARE = 0.8
"""Part of the joint limits that the shaped hand motion may ask for; the rest is for feedback,
posture and the curvature of the arm."""

TCP_SHARE = 0.9
"""Part of the tool's speed limit that the shaped command may use; the rest is for feedback."""

START_TOLERANCE = 5e-3
"""Largest distance between the workspace's start and its start configuration's hand, m."""


@dataclass(frozen=True)
class HandBounds:
    """Speed (norm, m/s), acceleration and jerk (per axis, m/s^2, m/s^3) of the shaped command."""

    speed: float
    acceleration: float
    jerk: float

    @property
    def stopping_s(self) -> float:
        """What a stop at full speed takes the hand on by, over that speed, s."""
        return 0.5 * (self.speed / self.acceleration + self.acceleration / self.jerk)


def derive_hand_bounds(
    workspace: Workspace, kinematics: ArmKinematics, limits: JointLimits, tcp_speed: float
) -> HandBounds:
    """Bounds that the joints can follow everywhere in the box.

    With J^+ the pseudo-inverse of the Jacobian (constant orientation, so its first three columns
    count), a hand acceleration u asks for joint accelerations J^+ u, up to terms in v^2. Over all
    directions of u, joint j needs at most |u| times the 2-norm of row j. The largest over start
    and corners of the box and over all joints decides; likewise for jerk and speed. (Acceleration
    and jerk are bounded per axis. Where several axes ask for theirs at once, the joint shaper
    slows them down together.)

    Raises:
        ConfigurationError: The start configuration does not put the hand at the start.
        KinematicsError: A corner of the box cannot be reached.
    """
    base = BaseFrame.of(workspace)
    rotation = base.rotations_to_base(rotation_from_quaternion(workspace.hand_quaternion_wxyz))
    start = np.array(workspace.start_configuration, dtype=np.float64)
    position, _ = kinematics.forward(start)
    distance = float(np.linalg.norm(base.to_task(position) - np.array(workspace.start)))
    if distance > START_TOLERANCE:
        raise ConfigurationError(
            f"the start configuration puts the hand {1e3 * distance:.1f} mm away from the start "
            f"position, allowed are {1e3 * START_TOLERANCE:.1f} mm; correct the task's layout"
        )
    corners = np.array(np.meshgrid(*zip(workspace.low, workspace.high, strict=True)))
    points = base.to_base(np.vstack([corners.reshape(3, 8).T, np.array(workspace.start)]))
    result = kinematics.inverse(points, rotation, start, max_iterations=50)
    require_converged(result)
    inverse = np.linalg.pinv(kinematics.jacobian(result.q))[:, :, :3]
    norm = np.linalg.norm(inverse, axis=2).max(axis=0)
    return HandBounds(
        speed=min(TCP_SHARE * tcp_speed, SHARE * float((limits.velocity / norm).min())),
        acceleration=min(MAX_ACCELERATION, SHARE * float((limits.acceleration / norm).min())),
        jerk=min(MAX_JERK, SHARE * float((limits.jerk / norm).min())),
    )
