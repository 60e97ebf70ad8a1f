"""Motions of a lone robot, and what they must keep."""

from __future__ import annotations

import numpy as np
from lone_robot import LoneRobot

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.robot_models import limits as joint_limits
from skewmi.trajectory import GRID_NS, JointTrajectory

LAB = joint_limits.profile("lab")
OURS, OTHER, GRIPPER = b"a" * 16, b"b" * 16, b"g" * 16


def start_motion(robot: LoneRobot, size: float = 0.03) -> StartMotion:
    start = robot.commanded
    return StartMotion(start, start + size * np.array([1, -0.5, 0, 0.5, 0, 1, 0]), LAB)


def motion_from(robot: LoneRobot, size: float = 0.03) -> JointTrajectory:
    return start_motion(robot, size).trajectory


def start_moving(robot: LoneRobot, size: float = 0.03) -> JointTrajectory:
    motion = motion_from(robot, size)
    robot.requests.arm(OURS + GRIPPER, 0)
    assert robot.controller.receive(robot.payload(motion, robot.due + 3), OURS, 1, 0)
    return motion


def assert_within_limits(q: np.ndarray) -> None:
    """By differences of commanded positions on the grid: what a servo sees."""
    h = GRID_NS / 1e9
    for order, bound in ((1, LAB.velocity), (2, LAB.acceleration), (3, LAB.jerk)):
        peak = np.abs(np.diff(q, n=order, axis=0)).max(axis=0) / h**order
        assert (peak <= bound * (1 + 1e-6)).all(), (order, peak / bound)
