"""What judges a chunk, put together: on the side that sends it, and on the side that follows it.

Both use the limits' code; nothing else of the two is shared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from skewmi.deploy.safety.flange_space import FlangeSpace, SpaceCheck
from skewmi.deploy.safety.guard import Guard
from skewmi.deploy.safety.limits import (
    TCP_SPEED_LIMIT,
    WORKSPACE_TOLERANCE,
    ChunkChecker,
    Forward,
    LimitUsage,
)
from skewmi.deploy.safety.validation import LimitCheck
from skewmi.errors import LimitViolationError
from skewmi.policy_io import Workspace
from skewmi.robot_models.base_frame import box_from_base
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.limits import JointLimits
from skewmi.robot_models.obstacle import Obstacle
from skewmi.trajectory import Array, JointPoint, JointTrajectory

Check = Callable[[JointTrajectory, JointPoint, Array], LimitUsage | None]
"""(samples, motion in progress at the first sample, its positions at the three grid steps before)
-> usage; raises LimitViolationError."""


_ROUNDING = 1e-6
"""m"""


class ChunkChecks:
    """Limit checker and guard, with or without the workspace box.

    On the way to a start the arm stays clear of the scene if it comes from beside the box
    (`begin_way`). Inside it is meant to touch things, there as in an episode.

    Args:
        limits: Of the joints.
        workspace: The task's box.
        flange_speed: That the robot admits, m/s.
        obstacles: What stands before the robot.
    """

    def __init__(
        self,
        limits: JointLimits,
        workspace: Workspace,
        flange_speed: float = TCP_SPEED_LIMIT,
        obstacles: Sequence[Obstacle] = (),
    ) -> None:
        forward = ArmKinematics("right").forward
        speed = min(flange_speed, TCP_SPEED_LIMIT)
        self._checkers = {
            False: (ChunkChecker(limits, None, forward, tcp_speed=speed), Guard(limits, None)),
            True: (
                ChunkChecker(limits, workspace, forward, tcp_speed=speed),
                Guard(limits, workspace),
            ),
        }
        self._open_guard = self._checkers[False][1]
        self._clear_guard = Guard(limits, None, obstacles=obstacles)
        self._workspace = workspace
        self.boxed = False
        """Whether the hand has to stay in the box; not on the way to the start."""

    def begin_way(self, q: Array) -> None:
        """A way to a start begins; it keeps clear of the scene unless it begins inside the box.

        Where the arm stands too near something it may leave, but come no nearer
        (`ClearanceCheck.permit_leaving`).

        Args:
            q: Where the arm rests, rad. Shape (7,).
        """
        low, high, base = box_from_base(self._workspace)
        place = base.vectors_to_task(self._open_guard.tool(q)[0])
        outside = float(np.maximum(low - place, place - high).max())
        guard = self._open_guard
        if outside > WORKSPACE_TOLERANCE:
            guard = self._clear_guard
            guard.clearance.permit_leaving(q)
        self._checkers[False] = (self._checkers[False][0], guard)

    @property
    def stages(self) -> Sequence[tuple[str, Check]]:
        """Both checks with the names of their stages."""
        return (("check", self._check), ("guard", self._guard))

    def _check(self, samples: JointTrajectory, previous: JointPoint, earlier: Array) -> LimitUsage:
        checker = self._checkers[self.boxed][0]
        return checker.check(samples.q, samples.v, samples.a, previous, earlier=earlier)

    def _guard(self, samples: JointTrajectory, previous: JointPoint, earlier: Array) -> None:
        del previous, earlier
        self._checkers[self.boxed][1].check(samples.q, samples.v, samples.a)


class SpaceChecks:
    """Limit checker and guard of a workspace other than the task's, as `ChunkChecks` has them.

    Stricter than the robot server, which tolerates 5 mm, and looks at no distances.

    Args:
        limits: Of the joints.
        space: Where the hand may be.
        obstacles: That the arm stays clear of.
        admitted_speed: Of the flange, m/s, if the robot asks for less than everybody keeps to.
    """

    def __init__(
        self,
        limits: JointLimits,
        space: FlangeSpace,
        obstacles: Sequence[Obstacle] = (),
        admitted_speed: float = TCP_SPEED_LIMIT,
    ) -> None:
        self.limits = limits
        self.space = space
        self.obstacles = tuple(obstacles)
        self.guard = Guard(limits, None, obstacles=self.obstacles)
        self._check = SpaceCheck(
            limits,
            space,
            ArmKinematics("right").forward,
            admitted_speed=admitted_speed,
            tolerance=0.0,
        )

    @property
    def stages(self) -> Sequence[tuple[str, Check]]:
        """Both checks with the names of their stages."""
        return (("check", self._check), ("guard", self._guard))

    def check_way(self, q: Array) -> None:
        """Look at a way before any of it is followed: where it leads, and what is near it.

        Args:
            q: Configurations in their order, near each other, rad. Shape (n, 7).

        Raises:
            LimitViolationError: It leads out of the space or too low in it, beyond what a joint
                reaches, or through something.
        """
        beyond = np.maximum(self.limits.position_lower - q, q - self.limits.position_upper)
        k, joint = np.unravel_index(int(beyond.argmax()), beyond.shape)
        if not beyond[k, joint] <= 0.0:  # also what is no number
            below = q[k, joint] < self.limits.position_lower[joint]
            bound = self.limits.position_lower if below else self.limits.position_upper
            raise LimitViolationError(
                "joint position, rad",
                float(q[k, joint]),
                float(bound[joint]),
                f"joint index {joint}",
            )
        self._check.check_way(q)
        self.guard.clearance.check(q)

    def _guard(self, samples: JointTrajectory, previous: JointPoint, earlier: Array) -> None:
        del previous, earlier
        self.guard.check(samples.q, samples.v, samples.a)


def limit_check(
    limits: JointLimits, workspace: Workspace | None, admitted_speed: float = TCP_SPEED_LIMIT
) -> LimitCheck:
    """The limits that the robot server enforces: joints and hand speed always, the box from inside.

    A motion that starts outside the box (on the way to the start pose) is only checked for joint
    limits and hand speed until it is inside; then it cannot leave. The room that the checker
    leaves around the box counts as inside: else the way out would lead through it.

    Args:
        limits: Of the joints.
        workspace: The task's box; None if there is none.
        admitted_speed: Of the flange, m/s, if the robot asks for less than everybody keeps to.
    """
    speed = min(admitted_speed, TCP_SPEED_LIMIT)
    forward = _SharedForward(ArmKinematics("right").forward)
    anywhere = ChunkChecker(limits, None, forward, tcp_speed=speed)

    def check_anywhere(samples: JointTrajectory, present: JointPoint, earlier: Array) -> object:
        return anywhere.check(samples.q, samples.v, samples.a, present, earlier=earlier)

    if workspace is None:
        return check_anywhere
    inside = ChunkChecker(limits, workspace, forward, tcp_speed=speed)
    low, high, base = box_from_base(workspace)
    room = WORKSPACE_TOLERANCE + _ROUNDING
    low, high = low - room, high + room

    def check(samples: JointTrajectory, present: JointPoint, earlier: Array) -> object:
        # The first sample is where the accepted plan is, or the checker refuses it: their
        # distance, 1e-9 rad at most, is far less than the rounding that is allowed for.
        place = base.vectors_to_task(forward.begin(samples.q)[0])
        outside = np.maximum(low - place, place - high)
        within = outside.max(axis=1) <= 0.0
        checker = inside if within[0] else anywhere
        usage = checker.check(samples.q, samples.v, samples.a, previous=present, earlier=earlier)
        left = outside[np.logical_or.accumulate(within)].max(axis=0, initial=0.0)
        if left.any():
            raise LimitViolationError(
                "distance outside the workspace, m",
                float(left.max()) + WORKSPACE_TOLERANCE,
                WORKSPACE_TOLERANCE,
                f"axis {'xyz'[int(left.argmax())]}",
            )
        return usage

    return check


def space_checks(
    limits: JointLimits,
    spaces: Mapping[str, FlangeSpace],
    admitted_speed: float = TCP_SPEED_LIMIT,
) -> dict[str, LimitCheck]:
    """What the robot server enforces in workspaces other than the task's, by name.

    Args:
        limits: Of the joints.
        spaces: By name.
        admitted_speed: As in `limit_check`.
    """
    forward = ArmKinematics("right").forward
    return {
        name: SpaceCheck(limits, space, forward, admitted_speed=admitted_speed)
        for name, space in spaces.items()
    }


class _SharedForward:
    """Forward kinematics that are worked out once for all who judge a chunk."""

    def __init__(self, forward: Forward) -> None:
        self._forward = forward
        self._chunk: Array | None = None

    def begin(self, q: Array) -> tuple[Array, Array]:
        """Work them out for a chunk. Until the next `begin` it must not be written to."""
        self._poses, self._chunk = self._forward(q), q
        return self._poses

    def __call__(self, q: Array) -> tuple[Array, Array]:
        return self._poses if q is self._chunk else self._forward(q)
