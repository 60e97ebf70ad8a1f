"""A box that stands before the robot: for whoever plans motion, and for whoever judges it."""

from __future__ import annotations

from dataclasses import dataclass

from skewmi.robot_models.yumi import Vector


@dataclass(frozen=True)
class Obstacle:
    """A box on the table, or above it, that stands upright."""

    centre: Vector
    """In the robot base frame, m."""
    half_size: Vector
    """m."""
    yaw: float = 0.0
    """About the base's z axis, rad."""
    name: str = ""
    """What it is, for messages."""

    @property
    def top(self) -> float:
        """Height of its upper side in the robot base frame, m."""
        return self.centre[2] + self.half_size[2]
