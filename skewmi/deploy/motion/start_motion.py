"""Joint motion from rest at one configuration to rest at another, as chunks.

The whole motion is computed beforehand by ruckig's position interface: synchronised in phase,
hence on a straight line in joint space, with bounded velocity, acceleration and jerk. On a
straight line no joint passes its two end positions, so the position limits hold if both ends are
inside. Chunk k starts at sample 5k, brings the next five samples, and brakes with the fastest
stop from there; if nobody sends chunk k + 1 the arm stops by itself, as it does while a policy
runs.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import ruckig

from skewmi.deploy import limits as chunk_limits
from skewmi.deploy.motion.brake import Array, plan_stop
from skewmi.deploy.motion.joint_shaper import HEADROOM
from skewmi.deploy.motion.planner import PlannedChunk
from skewmi.errors import ConfigurationError, LimitViolationError
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.limits import JointLimits

TCP_SHARE = 0.95
"""Part of the tool's speed limit that the motion uses."""


class StartMotion:
    """A motion between two configurations.

    Args:
        q_start: Where the arm rests, rad. Shape (7,).
        q_end: Where it shall rest, rad. Shape (7,).
        limits: Joint limits, scaled to the wanted speed.
        cycle_dt: Time between two chunks, s.
        grid_dt: Time between two samples, s.
        tcp_speed: The checker's limit on the tool's speed, m/s; the motion is slowed to stay
            below.

    Raises:
        LimitViolationError: A configuration is not finite or outside the position limits.
        ConfigurationError: The times do not fit.
    """

    def __init__(
        self,
        q_start: Array,
        q_end: Array,
        limits: JointLimits,
        *,
        cycle_dt: float = 0.02,
        grid_dt: float = chunk_limits.GRID_DT,
        tcp_speed: float = chunk_limits.TCP_SPEED_LIMIT,
    ) -> None:
        self.samples_per_cycle = round(cycle_dt / grid_dt)
        if self.samples_per_cycle < 1 or abs(self.samples_per_cycle * grid_dt - cycle_dt) > 1e-9:
            raise ConfigurationError(
                f"cycle_dt {cycle_dt} s must be a multiple of grid_dt {grid_dt} s"
            )
        self._grid_dt = grid_dt
        self._acceleration = HEADROOM * limits.acceleration
        self._jerk = HEADROOM * limits.jerk
        for name, q in (("start", q_start), ("end", q_end)):
            _require_inside(name, np.asarray(q, dtype=np.float64), limits)
        start, end = np.array(q_start, dtype=np.float64), np.array(q_end, dtype=np.float64)
        velocity = HEADROOM * limits.velocity * _tcp_scale(start, end, limits, tcp_speed)
        self.q, self.v, self.a = self._sample(start, end, velocity)

    @property
    def duration_s(self) -> float:
        """Time from the first sample to rest at the end."""
        return (len(self.q) - 1) * self._grid_dt

    @property
    def cycles(self) -> int:
        """How many chunks there are, at least one."""
        return max(1, -(-(len(self.q) - 1) // self.samples_per_cycle))

    def chunk(self, cycle: int) -> PlannedChunk:
        """The chunk that starts `cycle` cycles after the beginning, with its braking tail.

        Raises:
            ConfigurationError: `cycle` is negative. (After the last cycle the arm rests.)
        """
        if cycle < 0:
            raise ConfigurationError(f"cycle is {cycle}; it must not be negative")
        first = cycle * self.samples_per_cycle
        rows = np.minimum(np.arange(first, first + self.samples_per_cycle + 1), len(self.q) - 1)
        q, v, a = self.q[rows], self.v[rows], self.a[rows]
        stop = plan_stop(q[-1], v[-1], a[-1], self._acceleration, self._jerk)
        tail_q, tail_v, tail_a = stop.sample(self._grid_dt)
        return PlannedChunk(
            np.concatenate([q, tail_q]), np.concatenate([v, tail_v]), np.concatenate([a, tail_a])
        )

    def chunks(self) -> Iterator[PlannedChunk]:
        """All chunks in order."""
        return (self.chunk(cycle) for cycle in range(self.cycles))

    def _sample(self, start: Array, end: Array, velocity: Array) -> tuple[Array, Array, Array]:
        joints = len(start)
        request = ruckig.InputParameter(joints)
        request.current_position = start.tolist()
        request.target_position = end.tolist()
        request.max_velocity = velocity.tolist()
        request.max_acceleration = self._acceleration.tolist()
        request.max_jerk = self._jerk.tolist()
        request.synchronization = ruckig.Synchronization.Phase
        trajectory = ruckig.Trajectory(joints)
        ruckig.Ruckig(joints).calculate(request, trajectory)
        n = int(np.ceil(trajectory.duration / self._grid_dt - 1e-9)) + 1
        samples = np.array([trajectory.at_time(k * self._grid_dt) for k in range(n)])
        q, v, a = (np.ascontiguousarray(samples[:, i]) for i in range(3))
        q[-1], v[-1], a[-1] = end, 0.0, 0.0
        return q, v, a


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


def _tcp_scale(start: Array, end: Array, limits: JointLimits, tcp_speed: float) -> float:
    """Factor on the joint velocities that keeps the tool below its speed limit on the line.

    In phase, all joints move with ds/dt times (end - start); the joint that needs longest at full
    speed bounds ds/dt, and the tool moves with |J (end - start)| ds/dt.
    """
    line = end - start
    rate = 1.0 / max(float((np.abs(line) / limits.velocity).max()), 1e-9)
    s = np.linspace(0.0, 1.0, 101)[:, None]
    jacobian = ArmKinematics("right").jacobian(start + s * line)[:, :3]
    fastest = float(np.linalg.norm(jacobian @ line, axis=1).max()) * rate
    return min(1.0, TCP_SHARE * tcp_speed / max(fastest, 1e-9))
