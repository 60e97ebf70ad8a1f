"""The two independent checks of a chunk before it is sent: limits on the grid, and the guard."""

from __future__ import annotations

from collections.abc import Sequence

from skewmi.deploy.safety.guard import Guard
from skewmi.deploy.safety.limits import ChunkChecker, LimitUsage
from skewmi.deploy.session.stream import Check
from skewmi.policy_io import Array, Workspace
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.limits import JointLimits

State = tuple[Array, Array, Array]


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

    def _check(self, q: Array, v: Array, a: Array, previous: State, earlier: Array) -> LimitUsage:
        return self._checkers[self.boxed][0].check(q, v, a, previous, earlier=earlier)

    def _guard(self, q: Array, v: Array, a: Array, previous: State, earlier: Array) -> None:
        del previous, earlier
        self._checkers[self.boxed][1].check(q, v, a)
