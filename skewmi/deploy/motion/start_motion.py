"""Joint motion from rest at one configuration to rest at another, as chunks.

The motion is a straight line in joint space, q(t) = start + s(t) (end - start), and s runs from
0 to 1 with ruckig's position interface, within the tightest of the joints' velocity, acceleration
and jerk limits. On a straight line no joint passes its two end positions, so the position limits
hold if both ends are inside. Chunk k starts at sample 5k, brings the next five samples, and
brakes with the fastest stop of s from there; if nobody sends chunk k + 1 the arm stops by itself,
as it does while a policy runs. The stop stays on the line: joints that braked each for itself
could make the tool faster than the motion they brake.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import ruckig

from skewmi.deploy.motion.brake import Array, plan_stop
from skewmi.deploy.motion.joint_shaper import HEADROOM
from skewmi.deploy.safety.limits import TCP_SPEED_LIMIT
from skewmi.errors import ConfigurationError, LimitViolationError
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import CYCLE_TICKS, GRID_S, JointTrajectory

TCP_SHARE = 0.95
"""Part of the tool's speed limit that the motion uses."""

_NO_DISTANCE = 1e-9
"""Joint travel that bounds nothing, rad."""


class StartMotion:
    """A motion between two configurations.

    Args:
        q_start: Where the arm rests, rad. Shape (7,).
        q_end: Where it shall rest, rad. Shape (7,).
        limits: Joint limits, scaled to the wanted speed.
        flange_speed: That the robot admits, m/s.

    Raises:
        LimitViolationError: A configuration is not finite or outside the position limits.
    """

    def __init__(
        self,
        q_start: Array,
        q_end: Array,
        limits: JointLimits,
        *,
        flange_speed: float = TCP_SPEED_LIMIT,
    ) -> None:
        for name, q in (("start", q_start), ("end", q_end)):
            _require_inside(name, np.asarray(q, dtype=np.float64), limits)
        start, end = np.array(q_start, dtype=np.float64), np.array(q_end, dtype=np.float64)
        self._start, self._line = start, end - start
        distance = np.abs(self._line)
        # Where start and end are the same, any bound will do.
        share = np.maximum(distance, _NO_DISTANCE)
        velocity = HEADROOM * float((limits.velocity / share).min())
        self._velocity = velocity * _tcp_scale(start, self._line, velocity, flange_speed)
        self._acceleration = HEADROOM * float((limits.acceleration / share).min())
        self._jerk = HEADROOM * float((limits.jerk / share).min())
        self._s = self._sample()
        self.trajectory = self._on_line(self._s)
        self.trajectory.q[-1] = end
        """The whole motion."""

    @property
    def cycles(self) -> int:
        """How many chunks there are, at least one."""
        return max(1, -(-(len(self.trajectory) - 1) // CYCLE_TICKS))

    def chunk(self, cycle: int) -> JointTrajectory:
        """The chunk that starts `cycle` cycles after the beginning, with its braking tail.

        Raises:
            ConfigurationError: `cycle` is negative. (After the last cycle the arm rests.)
        """
        if cycle < 0:
            raise ConfigurationError(f"cycle is {cycle}; it must not be negative")
        first, last = cycle * CYCLE_TICKS, len(self.trajectory) - 1
        rows = np.minimum(np.arange(first, first + CYCLE_TICKS + 1), last)
        s, rate, acceleration = self._s[rows[-1]][:, None]
        stop = plan_stop(
            s, rate, acceleration, np.array([self._acceleration]), np.array([self._jerk])
        )
        tail = self._on_line(stop.sample(GRID_S)[..., 0].T)
        if rows[-1] == last:
            tail.q[:] = self.trajectory.q[-1]
        return JointTrajectory.concatenate(self.trajectory.part(rows), tail)

    def chunks(self) -> Iterator[JointTrajectory]:
        """All chunks in order."""
        return (self.chunk(cycle) for cycle in range(self.cycles))

    def _sample(self) -> Array:
        """s, ds/dt, d2s/dt2 on the grid, from rest at 0 to rest at 1. Shape (n, 3)."""
        request = ruckig.InputParameter(1)
        request.current_position, request.target_position = [0.0], [1.0]
        request.max_velocity = [self._velocity]
        request.max_acceleration = [self._acceleration]
        request.max_jerk = [self._jerk]
        trajectory = ruckig.Trajectory(1)
        ruckig.Ruckig(1).calculate(request, trajectory)
        n = int(np.ceil(trajectory.duration / GRID_S - 1e-9)) + 1
        samples = np.array([trajectory.at_time(k * GRID_S) for k in range(n)])[..., 0]
        samples[-1] = 1.0, 0.0, 0.0
        return samples

    def _on_line(self, s: Array) -> JointTrajectory:
        """The arm's motion of rows (s, ds/dt, d2s/dt2), shape (n, 3)."""
        q = self._start + s[:, :1] * self._line
        return JointTrajectory(q, s[:, 1:2] * self._line, s[:, 2:3] * self._line)


def _require_inside(name: str, q: Array, limits: JointLimits) -> None:
    if q.shape != (7,) or not np.isfinite(q).all():
        raise LimitViolationError("finite numbers", float("nan"), 0.0, f"{name} configuration {q}")
    beyond = np.maximum(limits.position_lower - q, q - limits.position_upper)
    worst = int(np.argmax(beyond))
    if beyond[worst] > 0.0:
        below = q[worst] < limits.position_lower[worst]
        bound = limits.position_lower if below else limits.position_upper
        raise LimitViolationError(
            "joint position",
            float(q[worst]),
            float(bound[worst]),
            f"joint index {worst} of the {name} configuration",
        )


def _tcp_scale(start: Array, line: Array, rate: float, flange_speed: float) -> float:
    """Factor on ds/dt that keeps the tool, which moves with |J line| ds/dt, below its limit.

    Args:
        start: rad. Shape (7,).
        line: From start to end, rad. Shape (7,).
        rate: Largest ds/dt, 1/s.
        flange_speed: The limit, m/s.
    """
    s = np.linspace(0.0, 1.0, 101)[:, None]
    jacobian = ArmKinematics("right").jacobian(start + s * line)[:, :3]
    fastest = float(np.linalg.norm(jacobian @ line, axis=1).max()) * rate
    return min(1.0, TCP_SHARE * flange_speed / max(fastest, 1e-9))
