"""From commanded hand positions to a smooth hand motion inside the workspace box.

The policy commands a position at the end of each control step. Between two commands the
*reference* r moves there on a straight line at constant speed, as the command does in training.
The *shaped* position x follows it with bounded acceleration and jerk: each grid step, the velocity

    u = r'(t) + k (r(t - T) - x(t))

is cut to the speed limit and, towards each face of the box, to the speed from which a stop before
the face is possible; ruckig's velocity interface then moves x's velocity towards u. T is the time
by which such a motion lags behind a step of u. Comparing x with the delayed reference means that
the feedback does not try to catch up a lag that cannot be avoided, which would overshoot every
stop by the braking distance; yet x cannot drift from r and settles on it when the policy stops.

A step after which the fastest stop would leave the box is replaced by that stop's first step, so
that by induction x never leaves the box.

Vectors are in the task's world frame, m and s, shape (3,).
"""

from __future__ import annotations

from collections import deque

import numpy as np
import ruckig

from skewmi.deploy.motion.brake import Array, approach_speed, plan_stop

FEEDBACK_GAIN = 5.0
"""k, 1/s. The shaper answers after about 50 ms; k times that is 0.25 rad of phase: no overshoot
that matters."""


class Reference:
    """The commanded position in time: straight to each target, then at rest there.

    Args:
        position_w: Where it rests at first. Shape (3,).
        delay_steps: T in calls of `advance`.
    """

    def __init__(self, position_w: Array, delay_steps: int) -> None:
        self.position_w = np.array(position_w, dtype=np.float64)
        self.velocity_w = np.zeros(3)
        self.target_w = self.position_w.copy()
        self._remaining_s = 0.0
        self._past = deque([self.position_w] * (delay_steps + 1), maxlen=delay_steps + 1)

    @property
    def delayed_w(self) -> Array:
        """r(t - T)."""
        return self._past[0]

    def set_target(self, target_w: Array, duration_s: float) -> None:
        """Move to `target_w` at constant velocity within `duration_s`, from wherever it is."""
        self.target_w = np.array(target_w, dtype=np.float64)
        self.velocity_w = (self.target_w - self.position_w) / duration_s
        self._remaining_s = duration_s

    def advance(self, dt: float) -> None:
        self._remaining_s -= dt
        if self._remaining_s > 1e-9:
            self.position_w = self.target_w - self.velocity_w * self._remaining_s
        else:
            self.position_w = self.target_w.copy()
        if self._remaining_s < -1e-9:
            self.velocity_w = np.zeros(3)
        self._past.append(self.position_w)


class CartesianShaper:
    """Position x, velocity and acceleration of the shaped command.

    Args:
        low: Lower corner of the box.
        high: Upper corner of the box.
        speed: Largest |velocity|, m/s.
        acceleration: Largest |acceleration| per axis, m/s^2.
        jerk: Largest |jerk| per axis, m/s^3.
        grid_dt: s.
    """

    def __init__(
        self,
        low: Array,
        high: Array,
        *,
        speed: float,
        acceleration: float,
        jerk: float,
        grid_dt: float,
    ) -> None:
        self.low = np.array(low, dtype=np.float64)
        self.high = np.array(high, dtype=np.float64)
        self._speed = speed
        self._acceleration = np.full(3, acceleration)
        self._jerk = np.full(3, jerk)
        self._grid_dt = grid_dt
        self._otg = ruckig.Ruckig(3)
        self._trajectory = ruckig.Trajectory(3)
        self._input = ruckig.InputParameter(3)
        self._input.control_interface = ruckig.ControlInterface.Velocity
        self._input.synchronization = ruckig.Synchronization.Phase
        self._input.max_acceleration = self._acceleration.tolist()
        self._input.max_jerk = self._jerk.tolist()
        self.position_w = (self.low + self.high) / 2.0
        self.velocity_w = np.zeros(3)
        self.acceleration_w = np.zeros(3)

    def reseed(self, position_w: Array, velocity_w: Array) -> None:
        """Continue from another state (of the hand), moved to where a stop in the box exists."""
        self.position_w = np.clip(position_w, self.low, self.high)
        self.velocity_w = self._clip_to_box(self._clip_speed(velocity_w))
        self.acceleration_w = np.zeros(3)

    def step(self, reference: Reference, hand_position_w: Array, leash: float) -> None:
        """Advance by one grid step towards the reference.

        Args:
            reference: Where the command is now; not advanced here.
            hand_position_w: Where the plan really has the hand.
            leash: From this distance between x and the hand on, x moves no further away: an arm
                that cannot follow (joint limit, singularity) must not be left behind.
        """
        wanted = reference.velocity_w + FEEDBACK_GAIN * (reference.delayed_w - self.position_w)
        ahead = self.position_w - hand_position_w
        distance = float(np.sqrt(ahead @ ahead))
        if distance > 0.5 * leash:
            direction = ahead / distance
            outward = max(0.0, float(wanted @ direction))
            share = min(1.0, 2.0 * distance / leash - 1.0)
            wanted = wanted - share * outward * direction
        wanted = self._clip_to_box(self._clip_speed(wanted))
        self._input.current_position = self.position_w.tolist()
        self._input.current_velocity = self.velocity_w.tolist()
        self._input.current_acceleration = self.acceleration_w.tolist()
        self._input.target_velocity = wanted.tolist()
        self._otg.calculate(self._input, self._trajectory)
        state = np.array(self._trajectory.at_time(self._grid_dt))
        if self._may_leave(state):
            self._stay_inside(state)
        self.position_w, self.velocity_w, self.acceleration_w = state

    def _may_leave(self, state: Array) -> bool:
        """Whether a stop could need more room than there is, cheaply and on the safe side.

        The present acceleration a, fading, covers at most |v a| / J + |a|^3 / 3 J^2 and adds
        a^2 / 2J to the velocity; the stop from there takes what `approach_speed` says.
        """
        x, v, a = state[0], np.abs(state[1]), np.abs(state[2])
        A, J = self._acceleration, self._jerk
        peak = v + a * a / (2.0 * J)
        room = v * a / J + a * a * a / (3.0 * J * J) + 0.5 * peak * (peak / A + A / J)
        return bool((np.minimum(x - self.low, self.high - x) <= room).any())

    def _stay_inside(self, state: Array) -> None:
        """Replace the axes of a new state whose fastest stop leaves the box by a stop's step."""
        x, v, a = state
        low, high = plan_stop(x, v, a, self._acceleration, self._jerk).extent()
        leaves = (low < self.low) | (high > self.high)
        if leaves.any():
            x, v, a = self.position_w, self.velocity_w, self.acceleration_w
            stop = plan_stop(x, v, a, self._acceleration, self._jerk).sample(self._grid_dt)
            state[:, leaves] = np.stack([samples[0] for samples in stop])[:, leaves]
            # The stop itself stays inside up to rounding.
            state[0] = np.clip(state[0], self.low, self.high)

    def _clip_speed(self, velocity_w: Array) -> Array:
        speed = float(np.sqrt(velocity_w @ velocity_w))
        return velocity_w if speed <= self._speed else velocity_w * (self._speed / speed)

    def _clip_to_box(self, velocity_w: Array) -> Array:
        ahead = approach_speed(self.high - self.position_w, self._acceleration, self._jerk)
        behind = approach_speed(self.position_w - self.low, self._acceleration, self._jerk)
        return np.clip(velocity_w, -behind, ahead)
