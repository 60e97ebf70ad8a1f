"""Where the robot base stands in a task's frame, and the calibrated box that decides it.

A task's frame is that of its box: policy, workspace box and scene are told in it. Where the box
stands elsewhere before the robot than it is believed to, the robot base stands elsewhere in the
frame. Both are upright, so that a point is enough, and a turn about the vertical:

    p_task = R(yaw) p_base + position

Whoever takes something from one frame to the other does it here. Numpy only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from skewmi.errors import ConfigurationError
from skewmi.robot_models.frames import BASE_IN_WORLD, rotation_about
from skewmi.robot_models.yumi import Array

LARGEST_SHIFT = 0.05
"""Of a box along x and y, m: beyond that it is another place, and a task has to be made for it."""
LARGEST_TURN_DEG = 20.0


class HasBase(Protocol):
    """A workspace, as `policy_io.Workspace` is one."""

    @property
    def base_position(self) -> tuple[float, float, float]: ...
    @property
    def base_yaw(self) -> float: ...


class HasBox(HasBase, Protocol):
    """The same with its box."""

    @property
    def low(self) -> tuple[float, float, float]: ...
    @property
    def high(self) -> tuple[float, float, float]: ...


@dataclass(frozen=True)
class BaseFrame:
    """The robot base frame in a task's frame.

    Attributes:
        position: Its origin, m.
        yaw: Its turn about the vertical, rad.

    Raises:
        ConfigurationError: A number is not finite.
    """

    position: tuple[float, float, float]
    yaw: float = 0.0

    def __post_init__(self) -> None:
        if len(self.position) != 3 or not np.isfinite((*self.position, self.yaw)).all():
            raise ConfigurationError(
                f"the robot base is said to be at {self.position} m, turned by {self.yaw} rad; "
                "give three finite numbers and one"
            )

    @staticmethod
    def of(workspace: HasBase) -> BaseFrame:
        """That of a workspace."""
        return BaseFrame(workspace.base_position, workspace.base_yaw)

    @cached_property
    def _origin(self) -> Array:
        return np.array(self.position, dtype=np.float64)

    @cached_property
    def rotation(self) -> Array:
        """Base to task. Shape (3, 3)."""
        return rotation_about(2, self.yaw)

    # Without a turn nothing is multiplied: not a bit differs from a shift alone.

    def to_task(self, position_b: ArrayLike) -> Array:
        """Points of the base frame in the task's, m. Shape (..., 3)."""
        return self.vectors_to_task(position_b) + self._origin

    def to_base(self, position_t: ArrayLike) -> Array:
        """Points of the task's frame in the base frame, m. Shape (..., 3)."""
        return self.vectors_to_base(np.asarray(position_t, dtype=np.float64) - self._origin)

    def vectors_to_task(self, vector_b: ArrayLike) -> Array:
        """Differences of points, or velocities, along the task's axes. Shape (..., 3)."""
        vector = np.asarray(vector_b, dtype=np.float64)
        return vector if self.yaw == 0.0 else vector @ self.rotation.T

    def vectors_to_base(self, vector_t: ArrayLike) -> Array:
        """The same along the base's axes. Shape (..., 3)."""
        vector = np.asarray(vector_t, dtype=np.float64)
        return vector if self.yaw == 0.0 else vector @ self.rotation

    def rotations_to_task(self, rotation_b: Array) -> Array:
        """Rotations to the base made rotations to the task. Shape (..., 3, 3)."""
        return rotation_b if self.yaw == 0.0 else self.rotation @ rotation_b

    def rotations_to_base(self, rotation_t: Array) -> Array:
        """Rotations to the task made rotations to the base. Shape (..., 3, 3)."""
        return rotation_t if self.yaw == 0.0 else self.rotation.T @ rotation_t


def box_from_base(workspace: HasBox) -> tuple[Array, Array, BaseFrame]:
    """A workspace's box from the robot base on, along the task's axes, which may be turned.

    Returns:
        Low and high corner, m, each shape (3,), and the base, whose `vectors_to_task` takes points
        of the base frame there.
    """
    base = BaseFrame.of(workspace)
    return np.array(workspace.low) - base.position, np.array(workspace.high) - base.position, base


NOMINAL_BASE = BaseFrame((float(BASE_IN_WORLD[0]), float(BASE_IN_WORLD[1]), 0.0))
"""Of every task whose box stands where it is believed to."""


@dataclass(frozen=True)
class BoxPose:
    """How far a task's box is from where it is believed to stand before the robot.

    Attributes:
        x, y: By how much its middle is shifted, along the robot's axes, m.
        yaw_deg: By how much it is turned about the vertical through its middle, degrees.
        origin_x, origin_y: Where that middle is believed to be, in the frame of the task whose
            box is not displaced, m.

    Raises:
        ConfigurationError: A number is not finite, or farther from nothing than is allowed.
    """

    x: float
    y: float
    yaw_deg: float
    origin_x: float
    origin_y: float

    def __post_init__(self) -> None:
        if not np.isfinite((self.x, self.y, self.yaw_deg, self.origin_x, self.origin_y)).all():
            raise ConfigurationError(
                f"{self.words}, about {self.origin_x}, {self.origin_y} m: not finite numbers all"
            )
        if max(abs(self.x), abs(self.y)) > LARGEST_SHIFT or abs(self.yaw_deg) > LARGEST_TURN_DEG:
            raise ConfigurationError(
                f"{self.words}; a policy can follow it by {1e3 * LARGEST_SHIFT:g} mm along x and y "
                f"and {LARGEST_TURN_DEG:g} degrees: put the box nearer to its place, and find it "
                "again by skewmi calibrate scene"
            )

    @property
    def words(self) -> str:
        """For messages: where the box is said to stand."""
        return (
            f"the calibration says that the box stands {1e3 * self.x:+.3f} mm along x, "
            f"{1e3 * self.y:+.3f} mm along y and {self.yaw_deg:+.4f} degrees off its place"
        )

    def base_frame(self, nominal: BaseFrame = NOMINAL_BASE) -> BaseFrame:
        """Where the robot base is in the displaced box's frame.

        With the displacement p' = R (p - o) + o + d of the box, it is R^T (b - o - d) + o, turned
        back by as much as the box is turned.

        Args:
            nominal: Where it is in that of a box that is not displaced.
        """
        if self.x == self.y == self.yaw_deg == 0.0:
            return nominal
        middle = np.array([self.origin_x, self.origin_y, 0.0])
        shift = np.array([self.x, self.y, 0.0])
        turn = np.radians(self.yaw_deg)
        back = rotation_about(2, -turn)
        x, y, z = (back @ (np.array(nominal.position) - middle - shift) + middle).tolist()
        return BaseFrame((x, y, z), float(nominal.yaw - turn))

    def as_mapping(self) -> dict[str, float]:
        """By name, for documents."""
        return asdict(self)

    @staticmethod
    def of_mapping(numbers: Mapping[str, float]) -> BoxPose | None:
        """Inverse of `as_mapping`; None for an empty one, which is a box that nobody looked for.

        Raises:
            ConfigurationError: It is not one.
        """
        if not numbers:
            return None
        try:
            return BoxPose(**{name: float(value) for name, value in numbers.items()})
        except (TypeError, ValueError) as error:
            raise ConfigurationError(
                f"the box's pose is told as {dict(numbers)}; it needs the numbers x, y, yaw_deg, "
                "origin_x and origin_y"
            ) from error


def base_of(box: BoxPose | None, nominal: BaseFrame = NOMINAL_BASE) -> BaseFrame:
    """Where the robot base is in a task's frame; `nominal` if nothing is known of its box."""
    return nominal if box is None else box.base_frame(nominal)
