"""One cycle of the arm: what is due now is written, and the arm is watched for following it."""

from __future__ import annotations

import numpy as np

from skewmi.deploy.robot.backend import (
    BackendFaultError,
    RobotBackend,
    RobotState,
    SendsAhead,
)
from skewmi.deploy.robot.executor import PlanExecutor
from skewmi.policy_io import Array
from skewmi.trajectory import JointPoint

TRACKING_LIMIT = 0.35
"""Largest |measured - commanded| of a joint, rad, before the robot server calls it a fault."""


class PlanFollower:
    """Samples the plan at the robot's own times.

    Args:
        backend: The robot.
        start_ns: What the server's clock shows at the robot's first cycle, see
            `backend.fresh_start_ns`.
        tracking_limit: Joint error that counts as a fault, rad.
    """

    def __init__(
        self, backend: RobotBackend, start_ns: int = 0, tracking_limit: float = TRACKING_LIMIT
    ) -> None:
        self._backend = backend
        self._ahead = backend if isinstance(backend, SendsAhead) else None
        self._joints = len(backend.joint_names)
        self._start_ns = start_ns
        self._tracking_limit = tracking_limit
        self._commanded: JointPoint | None = None
        self.state: RobotState | None = None
        """The newest one; None before the robot's first cycle."""
        self.executed_ns = start_ns - backend.period_ns
        """The newest cycle, by the server's clock."""
        self.plan = PlanExecutor(np.zeros(self._joints), self.executed_ns)
        """Of no meaning before the first cycle: then it becomes to stay where the arm is."""

    @property
    def clock_ns(self) -> int:
        """When the next sample is due."""
        return self.executed_ns + self._backend.period_ns

    @property
    def at_rest(self) -> bool:
        """Whether the plan has been executed, its last sample included."""
        return self.plan.at_rest(self.executed_ns)

    @property
    def commanded(self) -> JointPoint:
        """What was written in the newest cycle, unless the arm has been moved since."""
        assert self._commanded is not None
        return self._commanded

    @property
    def measured(self) -> Array:
        """Arm joints in the newest cycle, rad. Shape (n_joints,)."""
        assert self.state is not None
        return self.state.position[: self._joints]

    def cycle(self, state: RobotState) -> None:
        """Answer one cycle of the robot.

        Raises:
            BackendFaultError: The arm does not follow, or the robot cannot, or does not tell where
                it is.
        """
        first, error = self.state is None, None
        self.executed_ns = self._start_ns + state.time_ns
        if not np.isfinite(state.position[: self._joints]).all():
            # It is not kept: nothing may be commanded to such a place later.
            error = "the robot tells a position of the arm that is not finite"
            if first:
                raise BackendFaultError(error)
        else:
            self.state = state
        if error is None and (first or not state.guided):
            self._stay_at(self.measured)
        elif error is None:
            error = self._tracking_error()
        self._commanded = self.plan.at(self.executed_ns)
        self._backend.write(self._commanded)
        if error is not None:
            raise BackendFaultError(error)

    def rest_at(self, q: Array) -> None:
        """Forget the plan; from the next cycle on stay at `q`, shape (n_joints,), rad."""
        self._stay_at(q)
        self._commanded = self.plan.at(self.executed_ns)

    def _stay_at(self, q: Array) -> None:
        self.plan.rest_at(q, self.executed_ns)
        if self._ahead is not None:
            self._ahead.rest_at(q)

    def drop_what_has_not_begun(self) -> None:
        """A chunk may be due in a while: an arm that rests until then stays where it is."""
        self.plan.end_at_rest(self.executed_ns)

    def commanded_position(self) -> tuple[float, ...]:
        """Where the plan ends, rad; empty before the first cycle."""
        if self.state is None:
            return ()
        return tuple(map(float, self.plan.at(self.plan.end_ns).q))

    def _tracking_error(self) -> str | None:
        """Whether the arm is where it was commanded in the last cycle; in words if it is not."""
        assert self._commanded is not None
        error = float(np.abs(self.measured - self._commanded.q).max())
        if error <= self._tracking_limit:
            return None
        # Whatever holds the arm shall not be pulled at, nor the arm snap back once it is free.
        self._stay_at(self.measured)
        return (
            f"a joint is {error:.3g} rad from its command; "
            f"at most {self._tracking_limit:g} rad are allowed"
        )
