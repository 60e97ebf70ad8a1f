"""What every robot server has in common: the contract of a backend."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from skewmi.errors import SkewmiError
from skewmi.policy_io import Array
from skewmi.trajectory import GRID_NS, JointPoint

_CLOCK_STARTS_S = (1 << 28, 1 << 30)
"""Range of the clock's start, s: it fits a ROS time stamp for decades to come."""


class BackendFaultError(SkewmiError):
    """The robot itself cannot go on; the robot server goes to fault with this reason."""


@dataclass(frozen=True)
class Measurement:
    """What the robot measures at one tick.

    Attributes:
        names: The seven arm joints in chain order, then the finger.
        position: rad, and m for fingers. Shape (n,).
        velocity: rad/s and m/s. Shape (n,).
        effort: N m and N. Shape (n,).
        scene_names: Names of the scene's joints; empty without a scene.
        scene_position: rad or m. Shape (len(scene_names),).
        scene_velocity: rad/s or m/s. Shape (len(scene_names),).
    """

    names: tuple[str, ...]
    position: Array
    velocity: Array
    effort: Array
    scene_names: tuple[str, ...]
    scene_position: Array
    scene_velocity: Array


class RobotBackend(Protocol):
    """A robot that follows one joint target every 4 ms. Used by the robot server's loop alone."""

    name: str
    """What `describe` tells: `sim`, ..."""
    joint_names: tuple[str, ...]
    """The seven arm joints in chain order."""
    task: str
    """The task the scene belongs to."""
    layout_hashes: tuple[str, ...]
    """Every variant of the task's layout that this scene serves (with and without time, ...)."""
    scene_json: str
    """Shapes around the robot for replays, as `SceneGeometry.to_json`; empty if unknown."""
    simulated: bool
    """Whether the scene can be reset by a message."""

    def contact(self) -> Mapping[str, float]:
        """Largest of `skewmi.contact.QUANTITIES` since the scene's last reset; empty if unknown."""

    def arm_position(self) -> Array:
        """Measured arm joints alone, rad, chain order. Shape (7,)."""

    def measure(self) -> Measurement:
        """Present state; the arrays are not written to afterwards."""

    def step(self, target: JointPoint) -> None:
        """Follow `target` for one grid interval.

        Raises:
            BackendFaultError: The robot cannot.
        """

    def open_gripper(self, opening: float) -> None:
        """Move each finger to `opening` m from closed, from the next step on."""

    def reset_scene(self, seed: int) -> Array:
        """Start the episode `seed` says; returns where the arm rests now, shape (7,), rad.

        Raises:
            CommandRefusedError: The scene is real.
        """


def fresh_tick() -> int:
    """A tick for a robot server's clock to start from, on a full second.

    Drawn at random, so that what was recorded from one run of a robot server (a bag that somebody
    plays, a captured message) is never due in another: its stamps are years away. The time of
    day would not do, because robots without a clock battery start again at the same time.
    """
    low_s, high_s = _CLOCK_STARTS_S
    return (low_s + secrets.randbelow(high_s - low_s)) * 1_000_000_000 // GRID_NS
