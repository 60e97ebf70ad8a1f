"""The two independent checks of a chunk before it is sent: limits on the grid, and the guard."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from skewmi.deploy.safety.guard import Guard
from skewmi.deploy.safety.limits import ChunkChecker, LimitUsage
from skewmi.policy_io import Workspace
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import Array, JointPoint, JointTrajectory

Check = Callable[[JointTrajectory, JointPoint, Array], LimitUsage | None]
"""(samples, motion in progress at the first sample, its positions at the three grid steps before)
-> usage; raises LimitViolationError."""


class ChunkChecks:
    """Limit checker and guard, with or without the workspace box.

    Args:
        limits: Of the joints.
        workspace: The task's box.
    """

    def __init__(self, limits: JointLimits, workspace: Workspace) -> None:
        forward = ArmKinematics("right").forward
        self._checkers = {
            False: (ChunkChecker(limits, None, forward), Guard(limits, None)),
            True: (ChunkChecker(limits, workspace, forward), Guard(limits, workspace)),
        }
        self.boxed = False
        """Whether the hand has to stay in the box; not on the way to the start."""

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
