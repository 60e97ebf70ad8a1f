"""From commanded hand positions to a smooth hand motion inside the workspace box.

The policy commands a position at the end of each control step. Between two commands the
*reference* r moves there on a straight line at constant speed, as the command does in training.
The *shaped* position x follows it with bounded acceleration and jerk: each grid step, ruckig's
velocity interface moves x's velocity towards

    u = f + k (r - f T(f) - p)

f is the reference's velocity and p the position that x would have now if it had moved with f all
the time and ended where a transition to f, begun now, ends: p = x_end - f t_end, by ruckig. T(f)
is the lag of a transition from rest to f behind a step of f. So the feedback sees no error while x
is on its way to what is commanded: it neither tries to catch up a lag that cannot be avoided, which
would overshoot every stop by the braking distance, nor lets x drift from r. For the same reason
the feedback's velocity, k times the error, is never more than can be stopped within the error.

At a turn of the command the old velocity is taken back while the new one is built up: x cuts the
corner. Waiting there would keep to the path, and answer a policy later.

The velocity u is cut to the speed limit and, towards each face of the box, to the speed from which
a stop before the face is possible. A step after which the fastest stop would leave the box is
replaced by that stop's first step, so that by induction x never leaves the box.

Vectors are in the task's world frame, m and s, shape (3,). Inside they are lists: three numbers at
a time are faster without numpy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
import ruckig

from skewmi.deploy.motion.brake import Array, approach_speed_of, plan_stop, stop_extent_of
from skewmi.trajectory import GRID_S

FEEDBACK_GAIN = 5.0
"""Largest k, 1/s."""

FEEDBACK_PHASE = 0.5
"""Largest k times A / J, the time in which an acceleration is built up, rad: limits that change
velocity slowly get a smaller gain, as x would swing around r otherwise."""

Vector = Sequence[float]


class MovingPoint(Protocol):
    """Something with a position, m, and a velocity, m/s, in the world. Each of shape (3,)."""

    position_w: Array
    velocity_w: Array


class Reference:
    """The commanded position in time: straight to each target, then at rest there.

    Args:
        position_w: Where it rests at first. Shape (3,).
    """

    def __init__(self, position_w: Array) -> None:
        self.position_w = np.array(position_w, dtype=np.float64)
        self.velocity_w = np.zeros(3)
        self.target_w = self.position_w.copy()
        self._remaining_s = 0.0
        self._arrived = True

    def set_target(self, target_w: Array, duration_s: float) -> None:
        """Move to `target_w` at constant velocity within `duration_s`, from wherever it is."""
        self.target_w = np.array(target_w, dtype=np.float64)
        self.velocity_w = (self.target_w - self.position_w) / duration_s
        self._remaining_s = duration_s
        self._arrived = False

    def advance(self, dt: float) -> None:
        if self._arrived:
            return
        self._remaining_s -= dt
        if self._remaining_s > 1e-9:
            self.position_w = self.target_w - self.velocity_w * self._remaining_s
            return
        self.position_w = self.target_w.copy()
        if self._remaining_s < -1e-9:
            self.velocity_w = np.zeros(3)
            self._arrived = True


class CartesianShaper:
    """Position x, velocity and acceleration of the shaped command.

    Args:
        low: Lower corner of the box.
        high: Upper corner of the box.
        speed: Largest |velocity|, m/s.
        acceleration: Largest |acceleration| per axis, m/s^2.
        jerk: Largest |jerk| per axis, m/s^3.
        reference_delay_s: By how much the reference that it is given lags behind the command
            already, s: x need not lag behind that reference by as much more.
    """

    def __init__(
        self,
        low: Array,
        high: Array,
        *,
        speed: float,
        acceleration: float,
        jerk: float,
        reference_delay_s: float = 0.0,
    ) -> None:
        self._low: list[float] = np.asarray(low, dtype=np.float64).tolist()
        self._high: list[float] = np.asarray(high, dtype=np.float64).tolist()
        self._speed = speed
        self._acceleration = acceleration
        self._jerk = jerk
        self._reference_delay_s = reference_delay_s
        self._gain = min(FEEDBACK_GAIN, FEEDBACK_PHASE * jerk / acceleration)
        self._otg = ruckig.Ruckig(3)
        self._trajectory = ruckig.Trajectory(3)
        self._input = ruckig.InputParameter(3)
        self._input.control_interface = ruckig.ControlInterface.Velocity
        self._input.synchronization = ruckig.Synchronization.Phase
        self._input.max_acceleration = [acceleration] * 3
        self._input.max_jerk = [jerk] * 3
        self._x = [(a + b) / 2.0 for a, b in zip(self._low, self._high, strict=True)]
        self._v, self._a = [0.0] * 3, [0.0] * 3

    @property
    def position_w(self) -> Array:
        return np.array(self._x)

    @property
    def velocity_w(self) -> Array:
        return np.array(self._v)

    @property
    def acceleration_w(self) -> Array:
        return np.array(self._a)

    def reseed(self, position_w: Array, velocity_w: Array) -> None:
        """Continue from another state (of the hand), moved to where a stop in the box exists."""
        self._x = np.clip(position_w, self._low, self._high).tolist()
        self._v = self._clip_to_box(self._clip_speed(velocity_w.tolist()))
        self._a = [0.0] * 3

    def step(self, reference: MovingPoint, hand_position_w: Array, leash: float) -> None:
        """Advance by one grid step towards the reference.

        Args:
            reference: Where the command is now; not advanced here.
            hand_position_w: Where the plan really has the hand.
            leash: From this distance between x and the hand on, x moves no further away: an arm
                that cannot follow (joint limit, singularity) must not be left behind.
        """
        at, follow = reference.position_w.tolist(), self._clip_speed(reference.velocity_w.tolist())
        lag = self._lag(max(map(abs, follow)))
        x_end, t_end = self._transition(follow)
        error = [r - f * lag - (x - f * t_end) for r, f, x in zip(at, follow, x_end, strict=True)]
        distance = math.hypot(*error)
        # Nothing to divide by when there is no error.
        stoppable = approach_speed_of(distance, self._acceleration, self._jerk)
        k = min(self._gain, stoppable / max(distance, 1e-12))
        wanted = [f + k * e for f, e in zip(follow, error, strict=True)]
        wanted = self._keep_near(wanted, hand_position_w.tolist(), leash)
        self._transition(self._clip_to_box(self._clip_speed(wanted)))
        x, v, a = self._trajectory.at_time(GRID_S)
        for i in range(3):
            low, high = stop_extent_of(x[i], v[i], a[i], self._acceleration, self._jerk)
            if low < self._low[i] or high > self._high[i]:
                x[i], v[i], a[i] = self._stop_step(i)
        self._x, self._v, self._a = x, v, a

    def _transition(self, velocity_w: list[float]) -> tuple[list[float], float]:
        """Plan the change to a velocity; where and when it ends, from now."""
        plan = self._input
        plan.current_position = self._x
        plan.current_velocity = self._v
        plan.current_acceleration = self._a
        plan.target_velocity = velocity_w
        self._otg.calculate(plan, self._trajectory)
        duration = self._trajectory.duration
        return self._trajectory.at_time(duration)[0], duration

    def _lag(self, change: float) -> float:
        """Half of the time that a change of velocity along an axis takes, s, less the reference's
        own delay."""
        ramp = self._acceleration / self._jerk
        if change > self._acceleration * ramp:
            half = 0.5 * (change / self._acceleration + ramp)
        else:
            half = math.sqrt(change / self._jerk)
        return max(0.0, half - self._reference_delay_s)

    def _keep_near(self, velocity_w: list[float], hand_w: Vector, leash: float) -> list[float]:
        """Take away what would lead x further away from the hand than the leash."""
        ahead = [x - h for x, h in zip(self._x, hand_w, strict=True)]
        distance = math.hypot(*ahead)
        if distance <= 0.5 * leash:
            return velocity_w
        outward = sum(v * d for v, d in zip(velocity_w, ahead, strict=True)) / distance
        cut = min(1.0, 2.0 * distance / leash - 1.0) * max(0.0, outward) / distance
        return [v - cut * d for v, d in zip(velocity_w, ahead, strict=True)]

    def _stop_step(self, axis: int) -> tuple[float, float, float]:
        """The first step of the fastest stop of one axis. It stays inside up to rounding."""
        x, v, a, acceleration, jerk = (
            np.array([number])
            for number in (
                self._x[axis],
                self._v[axis],
                self._a[axis],
                self._acceleration,
                self._jerk,
            )
        )
        stop = plan_stop(x, v, a, acceleration, jerk)
        position, velocity, fade = (float(part[0, 0]) for part in stop.sample(GRID_S))
        return min(max(position, self._low[axis]), self._high[axis]), velocity, fade

    def _clip_speed(self, velocity_w: list[float]) -> list[float]:
        speed = math.hypot(*velocity_w)
        if speed <= self._speed:
            return velocity_w
        # Scaled first: the norm of a huge velocity is infinite.
        largest = max(map(abs, velocity_w))
        unit = [v / largest for v in velocity_w]
        scale = self._speed / math.hypot(*unit)
        return [scale * v for v in unit]

    def _clip_to_box(self, velocity_w: list[float]) -> list[float]:
        acceleration, jerk = self._acceleration, self._jerk
        return [
            min(
                max(v, -approach_speed_of(x - low, acceleration, jerk)),
                approach_speed_of(high - x, acceleration, jerk),
            )
            for v, x, low, high in zip(velocity_w, self._x, self._low, self._high, strict=True)
        ]
