"""Named workspaces other than the task's: what the hand may do in them, judged on its own.

"calibration" is clear space above and around the scene, to move every joint in. "touch" is the
same space with the scene in it, slow enough to touch things.

Like the task's box they hold from inside: the hand may enter from wherever it stands, and once it
is in it cannot leave. Its fingers stay above the scene (but for "touch"); a hand that stands lower,
as after an episode of the task, may go anywhere in the space but not lower still, until it is up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skewmi.deploy.safety.limits import (
    TCP_SPEED_LIMIT,
    WORKSPACE_TOLERANCE,
    ChunkChecker,
    Forward,
    LimitUsage,
)
from skewmi.errors import ConfigurationError, LimitViolationError
from skewmi.policy_io import Workspace
from skewmi.robot_models import yumi
from skewmi.robot_models.base_frame import BaseFrame
from skewmi.robot_models.limits import JointLimits
from skewmi.robot_models.obstacle import Obstacle
from skewmi.robot_models.yumi import Vector
from skewmi.trajectory import Array, JointPoint, JointTrajectory

TASK, CALIBRATION, TOUCH = "task", "calibration", "touch"
"""Names of workspaces."""

CLEAR_LOW: Vector = (0.20, -0.40, 0.17)
CLEAR_HIGH: Vector = (0.58, 0.20, 0.56)
"""The clear space before the right arm, for the flange, in the robot base frame, m.

x: from where the hand no longer meets the body, to where the arm (0.56 m from shoulder to flange)
is nearly stretched. y: the right arm's side of the table, and past the middle only as far as a
task's box goes, because the other arm is parked at +y. z: no point of the hand is more than 0.146 m
from the flange, so that at 0.17 m it clears the table by 24 mm however it is turned; up to where
the upper arm is level.
"""

ABOVE = 0.010
"""How far commanded fingers stay above the scene, m. Not more, so that the start of a task with its
fingers just above a lid is inside; who plans leaves as much more as the arm may not follow."""

HEADROOM = 0.15
"""Height that has to be left for the hand (pointing down) above the scene, m."""

TOUCH_SPEED = 0.010
"""Largest speed of flange and finger tips for guarded moves, m/s."""

FINGER_TIP = yumi.GRIPPER.finger_origin_z + yumi.GRIPPER.finger_size[2]
"""From the flange along its axis, m."""
_HAND_LOW = np.array([[-0.042, -0.035, 0.0], [-0.036, -0.008, yumi.GRIPPER.finger_origin_z]])
_HAND_HIGH = np.array(
    [[0.042, 0.035, yumi.GRIPPER.base_length], [0.036, 0.008, FINGER_TIP + 0.0005]]
)
_HAND_CENTRE, _HAND_HALF = (_HAND_LOW + _HAND_HIGH) / 2.0, (_HAND_HIGH - _HAND_LOW) / 2.0
"""Boxes around gripper and fingers, however far these are open, in the flange's frame, m."""

_ROUNDING = 1e-6
"""m"""


@dataclass(frozen=True)
class FlangeSpace:
    """A box for the flange, and what else holds in it. Vectors from the robot base on, m."""

    name: str
    low: Vector
    high: Vector
    fingers_above: float = 0.0
    """Height that no point of the hand may come below, m; 0 (the table top) does not bind."""
    speed: float = TCP_SPEED_LIMIT
    """Largest speed of the flange, and where it is less than usual also of the finger tips, m/s."""
    yaw: float = 0.0
    """Turn of the box's axes about the base's vertical, rad."""

    def __post_init__(self) -> None:
        low, high = np.array(self.low), np.array(self.high)
        numbers = (*self.low, *self.high, self.fingers_above, self.speed, self.yaw)
        if low.shape != (3,) or high.shape != (3,) or not np.isfinite(numbers).all():
            raise ConfigurationError(
                f"workspace {self.name!r} has corners {self.low} and {self.high}, height "
                f"{self.fingers_above} and speed {self.speed}; they must be three numbers each, "
                "and one each"
            )
        if not (low < high).all() or self.speed <= 0.0:
            raise ConfigurationError(
                f"workspace {self.name!r} from {self.low} to {self.high} m at {self.speed} m/s is "
                "empty or still; low must be below high, and the speed positive"
            )

    def numbers(self) -> dict[str, tuple[float, ...]]:
        """For a robot server's description."""
        told: dict[str, tuple[float, ...]] = {
            "low": tuple(self.low),
            "high": tuple(self.high),
            "fingers_above": (self.fingers_above,),
            "speed": (self.speed,),
        }
        return told if self.yaw == 0.0 else told | {"yaw": (self.yaw,)}

    @staticmethod
    def from_numbers(name: str, numbers: Mapping[str, Sequence[float]]) -> FlangeSpace:
        """Inverse of `numbers`.

        Raises:
            ConfigurationError: They do not describe a space.
        """
        try:
            (above,), (speed,) = numbers["fingers_above"], numbers["speed"]
            (yaw,) = numbers.get("yaw", (0.0,))
            (x, y, z), (high_x, high_y, high_z) = numbers["low"], numbers["high"]
        except (KeyError, ValueError, TypeError) as error:
            raise ConfigurationError(
                f"workspace {name!r} is told as {dict(numbers)}; it needs low, high, fingers_above "
                "and speed"
            ) from error
        return FlangeSpace(name, (x, y, z), (high_x, high_y, high_z), above, speed, yaw)


def flange_spaces(
    workspace: Workspace | None, obstacles: Sequence[Obstacle]
) -> dict[str, FlangeSpace]:
    """What can be granted besides the task's box, by name; nothing where the scene does not permit.

    Args:
        workspace: The task's; None if there is none, and so nobody knows what stands there.
        obstacles: Of the scene; empty if its shapes are not known.
    """
    if workspace is None or not obstacles:
        return {}
    corners = np.array(np.meshgrid(*zip(workspace.low, workspace.high, strict=True)))
    corners = BaseFrame.of(workspace).to_base(corners.reshape(3, 8).T)
    low, high = corners.min(axis=0), corners.max(axis=0)
    above = max(box.top for box in obstacles) + ABOVE
    holds_task = (np.array(CLEAR_LOW) <= low).all() and (high <= np.array(CLEAR_HIGH)).all()
    if not holds_task or above + FINGER_TIP + HEADROOM > CLEAR_HIGH[2]:
        return {}
    return {
        CALIBRATION: FlangeSpace(CALIBRATION, CLEAR_LOW, CLEAR_HIGH, above),
        TOUCH: FlangeSpace(TOUCH, CLEAR_LOW, CLEAR_HIGH, speed=TOUCH_SPEED),
    }


def lowest_of_hand(position: Array, rotation: Array) -> Array:
    """Height of the lowest point of gripper and fingers.

    Args:
        position: Of the flange, m. Shape (n, 3).
        rotation: Flange to base. Shape (n, 3, 3).

    Returns:
        m. Shape (n,).
    """
    up = rotation[:, 2]
    below: Array = (up @ _HAND_CENTRE.T - np.abs(up) @ _HAND_HALF.T).min(axis=1)
    return position[:, 2] + below


class SpaceCheck:
    """Limits of the joints and of the hand in a space; a `LimitCheck`.

    Args:
        limits: Of the joints.
        space: Where the hand may be.
        forward: See `ChunkChecker`.
        admitted_speed: Of the flange, m/s, if the robot asks for less than everybody keeps to.
        tolerance: How far flange and fingers may be beyond, m: nothing for who plans.
    """

    def __init__(
        self,
        limits: JointLimits,
        space: FlangeSpace,
        forward: Forward,
        *,
        admitted_speed: float = TCP_SPEED_LIMIT,
        tolerance: float = WORKSPACE_TOLERANCE,
    ) -> None:
        self._forward = forward
        self._speed = min(space.speed, admitted_speed, TCP_SPEED_LIMIT)
        self._checker = ChunkChecker(limits, None, forward, tcp_speed=self._speed)
        self._slow = space.speed < TCP_SPEED_LIMIT
        self._low, self._high = np.array(space.low), np.array(space.high)
        self._axes = BaseFrame((0.0, 0.0, 0.0), -space.yaw)
        self._above = space.fingers_above
        self._tolerance = tolerance

    def __call__(
        self, samples: JointTrajectory, previous: JointPoint, earlier: Array
    ) -> LimitUsage:
        """Accept motion or raise.

        Args:
            samples: From when they are due on.
            previous: The motion in progress at the first sample.
            earlier: Its positions at the three grid steps before, rad. Shape (3, 7).

        Returns:
            How much of each limit it uses.

        Raises:
            LimitViolationError: Names what is broken.
        """
        usage = self._checker.check(samples.q, samples.v, samples.a, previous, earlier=earlier)
        position, rotation = self._forward(samples.q)
        if self._slow:
            usage = usage.merged(self._check_tips(position, rotation))
        return usage.merged(self._check_places(position, rotation))

    def check_way(self, q: Array) -> LimitUsage:
        """Accept a way or raise: where it leads alone, no times.

        Args:
            q: Configurations in their order, near each other, rad. Shape (n, 7).

        Raises:
            LimitViolationError: The hand leaves the space, or comes too low in it.
        """
        return self._check_places(*self._forward(q))

    def _check_places(self, position: Array, rotation: Array) -> LimitUsage:
        position = self._axes.vectors_to_task(position)
        outside = np.maximum(self._low - position, position - self._high)
        excess = outside.max(axis=1)
        began_inside = bool(excess[0] <= self._tolerance + _ROUNDING)
        inside = excess <= self._tolerance
        entered = np.logical_or.accumulate(inside) | began_inside
        if (entered & ~inside).any():
            left = outside[entered]
            axis = f"axis {'xyz'[int(left.max(axis=0).argmax())]}"
            raise LimitViolationError(
                "distance outside the workspace, m", float(left.max()), self._tolerance, axis
            )
        self._check_height(position, rotation, inside, began_inside=began_inside)
        middle, half = (self._low + self._high) / 2.0, (self._high - self._low) / 2.0
        use = (np.abs(position - middle) / half)[entered].max(initial=0.0)
        return LimitUsage(workspace=float(use))

    def _check_tips(self, position: Array, rotation: Array) -> LimitUsage:
        """A hand that turns about its flange moves its fingers, too."""
        steps = np.diff(position + FINGER_TIP * rotation[..., 2], axis=0)
        speed = float(np.sqrt((steps * steps).sum(axis=1).max())) / self._checker.grid_dt
        if speed > self._speed:
            raise LimitViolationError("speed of the finger tips, m/s", speed, self._speed)
        return LimitUsage(tcp_speed=speed / self._speed)

    def _check_height(
        self, position: Array, rotation: Array, inside: NDArray[np.bool_], *, began_inside: bool
    ) -> None:
        """Of the lowest point of the hand, wherever the flange is inside."""
        if self._above <= 0.0:
            return
        lowest = lowest_of_hand(position, rotation)
        bound = self._above - self._tolerance
        bounds = np.full(len(lowest), bound)
        if began_inside and lowest[0] < bound - _ROUNDING:
            up = np.logical_or.accumulate(inside & (lowest >= bound))
            bounds[~up] = lowest[0]
        low = np.where(inside, bounds - lowest, -np.inf)
        worst = int(low.argmax())
        if low[worst] > 0.0:
            raise LimitViolationError(
                "height of the fingers, m", float(lowest[worst]), float(bounds[worst]), "at least"
            )
