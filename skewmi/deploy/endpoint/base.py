"""What every robot endpoint has in common: the contract of a backend."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from skewmi.deploy.endpoint.executor import PlanPoint
from skewmi.errors import SkewmiError
from skewmi.policy_io import Array

GRID_NS = 4_000_000
"""The endpoint's grid: one joint target every 4 ms, as the controller's EGM asks for them."""

STATE_PERIOD_TICKS = 5
"""Joint and scene states are published every 5 ticks, 20 ms: the daemon's planner cycle."""


class BackendFaultError(SkewmiError):
    """The robot itself cannot go on; the endpoint goes to fault with this reason."""


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
    """A robot that follows one joint target every 4 ms. Used by the endpoint's loop alone."""

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

    def measure(self) -> Measurement:
        """Present state; the arrays are not written to afterwards."""

    def step(self, target: PlanPoint) -> None:
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
