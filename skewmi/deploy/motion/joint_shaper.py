"""Joint motion that follows wanted joint velocities with bounded acceleration and jerk."""

from __future__ import annotations

import numpy as np
import ruckig

from skewmi.deploy.motion.brake import ApproachSpeed, Array, Stop, plan_stop
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import GRID_S, JointPoint

HEADROOM = 0.999
"""Part of each bound that is used, so that rounding never shows as 100.0000001 %."""

POSITION_MARGIN = 2e-3
"""Distance from the limit profile's position bounds at which motion is steered to stop, rad."""

HARD_MARGIN = 1e-3
"""Distance from them that every published chunk keeps, rad. It covers what a position can exceed
the samples on both sides of it by, at most A h^2 / 8 = 3e-5 rad, many times over."""


FEEDBACK_PHASE = 0.5
"""Largest gain times delay of a feedback around the shaper, rad."""


class JointShaper:
    """State (q, v, a) of the planned arm, moved one grid step at a time.

    The velocity interface of ruckig knows bounds on acceleration and jerk only. The bound on
    velocity holds because every target is inside it and because a velocity that moves
    monotonically towards a target does not pass it; the bounds on position hold because of
    `velocity_bounds` and, provably, the check of stops in the planner.

    Args:
        limits: Joint limits.
    """

    def __init__(self, limits: JointLimits) -> None:
        self.lower = limits.position_lower + POSITION_MARGIN
        self.upper = limits.position_upper - POSITION_MARGIN
        self.hard_lower = limits.position_lower + HARD_MARGIN
        self.hard_upper = limits.position_upper - HARD_MARGIN
        self.velocity = HEADROOM * limits.velocity
        self.acceleration = HEADROOM * limits.acceleration
        self.jerk = HEADROOM * limits.jerk
        self._per_acceleration = 1.0 / self.acceleration
        self._ramp = self.acceleration / self.jerk
        self._approach = ApproachSpeed(self.acceleration, self.jerk)
        joints = self.velocity.size
        self._room = np.zeros((2, joints))
        self._otg = ruckig.Ruckig(joints)
        self._trajectory = ruckig.Trajectory(joints)
        self._input = ruckig.InputParameter(joints)
        self._input.control_interface = ruckig.ControlInterface.Velocity
        self._input.synchronization = ruckig.Synchronization.Phase
        self._input.max_acceleration = self.acceleration.tolist()
        self._input.max_jerk = self.jerk.tolist()
        self.point = JointPoint(np.zeros(joints), np.zeros(joints), np.zeros(joints))
        """The present state. The arrays are not written to."""

    @property
    def lag_steps(self) -> int:
        """By how many grid steps the shaper lags behind a velocity that changes as fast as it may.

        To follow an acceleration a, it must be a^2 / 2J behind in velocity, from where the
        acceleration can fade; that is a / 2J in time.
        """
        seconds = float((self.acceleration / (2.0 * self.jerk)).max())
        return round(seconds / GRID_S)

    def feedback_rate(self, largest: float) -> float:
        """Gain up to which a feedback around this shaper is well damped now, at most `largest`.

        The slowest joint's delay is A / J, in which an acceleration is built up, and |v| / A, in
        which the present velocity can be taken back: near singular postures a feedback on the
        hand asks for large velocities.

        Returns:
            1/s.
        """
        delay = float((np.abs(self.point.v) * self._per_acceleration + self._ramp).max())
        return min(largest, FEEDBACK_PHASE / delay)

    def velocity_bounds(self) -> tuple[Array, Array]:
        """Lowest and highest velocity to aim for here; zero lies between. Each (7,), rad/s."""
        np.subtract(self.point.q, self.lower, out=self._room[0])
        np.subtract(self.upper, self.point.q, out=self._room[1])
        down, up = np.minimum(self.velocity, self._approach(self._room))
        return -down, up

    def step(self, wanted: Array, low: Array, high: Array) -> None:
        """Advance by one grid step, the velocity moving towards the wanted one.

        Args:
            wanted: rad/s. Shape (7,).
            low: From `velocity_bounds`; `wanted` is clipped to them.
            high: Likewise.
        """
        q, v, a = self.point
        self._input.current_position = q.tolist()
        self._input.current_velocity = v.tolist()
        self._input.current_acceleration = a.tolist()
        self._input.target_velocity = np.minimum(np.maximum(wanted, low), high).tolist()
        self._otg.calculate(self._input, self._trajectory)
        self.point = JointPoint(*np.array(self._trajectory.at_time(GRID_S)))

    def stop(self) -> Stop:
        """The fastest stop from here."""
        return plan_stop(*self.point, self.acceleration, self.jerk)
