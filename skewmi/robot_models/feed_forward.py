"""Feed-forward for position servos whose constants are known: what is sent so that an arm follows.

A servo with stiffness kp and damping kd on a joint with dry friction F, its target late by d, does

    kp (x(t - d) - q) - kd q' = F sign(q') + inertia

so that a joint which gets its reference, x = q_d, is behind by d + kd / kp, and held off by
h = F / kp. Sent

    x = q_d + (kd / kp + d) v_d + h s

it follows, where s is the sign of the reference's motion. `ServoConstants.offset` says how s comes
to be; `FeedForward` makes of x a motion that a robot may be given.

One law for the batched simulation and the robot server. Numpy only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from skewmi.errors import ConfigurationError
from skewmi.robot_models.limits import JointLimits
from skewmi.robot_models.position_guard import INSIDE, PositionGuard
from skewmi.robot_models.yumi import Array
from skewmi.trajectory import GRID_S

TURNING = 2e-4
"""Way after which the friction fed forward has turned by 63 %, rad: as in Dahl's model of friction,
so that a reference which hardly moves does not throw the command from side to side."""
FORGETTING_S = 2.0
"""Time in which a resting reference's friction fades, s. Forgotten at once, a hand that is blocked
and whose command therefore rests 3 mm before it would never move an arm that needs 8 mm."""
LARGEST_OFFSET = 0.3
"""How far what is sent may be meant to be off the reference, rad: what kd / kp = 0.3 s needs at
1 rad/s. Wrong constants can do no more."""

_POSITION_GAIN = 25.0
"""Of the governor, 1/s: speed by which it makes up for an error."""
_VELOCITY_GAIN = 60.0
"""Of the governor, 1/s. More than twice the other: it does not swing about the reference."""
_BRAKING = 0.6
"""Part of acceleration and jerk that the governor means to brake with. What it keeps back is for a
reference that moves on meanwhile, and for the time that acceleration takes to build up."""
_KEPT = math.exp(-GRID_S / FORGETTING_S)


@dataclass(frozen=True)
class ServoConstants:
    """What feed-forward knows of seven servos, chain order.

    Attributes:
        lead: kd / kp, and how late the servos get their targets, s. Shape (7,).
        friction: Dry friction over kp, rad. Shape (7,).
    """

    lead: Array
    friction: Array

    def __post_init__(self) -> None:
        for name in ("lead", "friction"):
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.shape != (7,) or not np.all(np.isfinite(value)) or np.any(value < 0.0):
                raise ConfigurationError(
                    f"feed-forward {name} must be 7 finite numbers, none negative; got "
                    f"{value.tolist()}"
                )
            value.flags.writeable = False
            object.__setattr__(self, name, value)


PLANNED_ACCELERATION = 0.5
"""Part of the acceleration that a plan for known servos uses; the rest is feed-forward's."""
FED_FORWARD_JERK = 1.5
"""Acceleration that feed-forward makes of a plan's largest jerk, as part of the profile's. More
than there is, because a plan seldom has both at once, and a slower one is late for its policy."""


def followable(limits: JointLimits, constants: ServoConstants) -> JointLimits:
    """Limits for plans whose feed-forward a robot server can send within the given ones.

    What is sent is the plan, and ahead of it by lead times velocity: its acceleration is the plan's
    and lead times jerk. A plan that uses all of acceleration and jerk asks for ten times as much as
    is there. Then what is sent comes late, the arm swings about the plan, and a hand that is
    commanded by what is measured of it swings along.

    Args:
        limits: Of what is sent.
        constants: Of the servos that it is sent to.
    """
    jerk = FED_FORWARD_JERK * limits.acceleration / np.maximum(constants.lead, 1e-9)
    # One for all joints. Those that may change faster than others would not wait for them, and the
    # hand would leave its path and its upright.
    least = float(np.minimum(limits.jerk, jerk).min())
    return replace(
        limits,
        acceleration=PLANNED_ACCELERATION * limits.acceleration,
        jerk=np.full_like(limits.jerk, least),
    )


class FeedForward:
    """What is sent to the servos, tick by tick of 4 ms, for a reference that is given so.

    With limits, what is sent stays within their position bounds, and has first, second and third
    differences on the grid within their velocity, acceleration and jerk, whatever the reference
    does: acceleration changes by one tick's jerk at most, and is never more than can be taken back
    before the velocity is too large or, braking, the position beyond its bound. It comes to rest
    where the reference does, or at the bound that the reference is beyond.

    Without limits it is x itself, for references that have steps of velocity anyway: those of the
    batched simulation, whose policies count on following them at once.

    Args:
        constants: Of the servos.
        limits: Of what is sent; None for none.

    Attributes:
        constants, limits: As given.

    Raises:
        ConfigurationError: The position bounds are too near to each other for the other limits.
    """

    def __init__(self, constants: ServoConstants, limits: JointLimits | None) -> None:
        self.constants, self.limits = constants, limits
        self._governor = None if limits is None else _Governor(limits)

    def start(self, q: Array) -> None:
        """Begin at rest, where the reference rests.

        A joint outside its bounds goes no farther out, but in.

        Args:
            q: rad. Shape (..., 7).
        """
        self._sign = np.zeros_like(q)
        if self._governor is not None:
            self._governor.start(q)

    def step(self, q: Array, v: Array) -> Array:
        """What is sent for the next tick.

        Args:
            q, v: Of the reference at that tick, rad and rad/s. Shapes as in `start`.

        Returns:
            rad, of the same shape; not to be written to.
        """
        speed = np.abs(v)
        turned = speed / (speed + TURNING / GRID_S)
        self._sign = (1.0 - turned) * (_KEPT * self._sign) + turned * np.sign(v)
        offset = self.constants.lead * v + self.constants.friction * self._sign
        aim: Array = q + np.minimum(np.maximum(offset, -LARGEST_OFFSET), LARGEST_OFFSET)
        return aim if self._governor is None else self._governor.follow(aim)


class _Governor:
    """Follows an aim that may do anything, within limits.

    Args:
        limits: On the grid.
    """

    def __init__(self, limits: JointLimits) -> None:
        self._lower, self._upper = limits.position_lower + INSIDE, limits.position_upper - INSIDE
        # Rounding must not put a difference over its limit.
        room = 1.0 - 1e-6
        self._speed, self._acceleration = room * limits.velocity, room * limits.acceleration
        # Slower than 3 ticks' jerk (0.04 rad/s with `lab`), the guard could not keep the speed.
        self._jerk_step = np.minimum(room * limits.jerk * GRID_S, self._speed / (3.0 * GRID_S))
        self._velocity_knee = _BRAKING * limits.acceleration / _POSITION_GAIN**2
        self._acceleration_knee = _BRAKING * limits.jerk / _VELOCITY_GAIN**2
        self._guard = PositionGuard(limits, self._speed, self._acceleration, self._jerk_step)

    def start(self, q: Array) -> None:
        """At rest."""
        self._sent = self._aim = np.array(q, dtype=np.float64)
        self._v, self._a, self._aim_v = (np.zeros_like(self._sent) for _ in range(3))

    def follow(self, aim: Array) -> Array:
        """One tick nearer to the aim, rad, or with it where the limits let it."""
        speed, hardest = self._speed, self._acceleration
        aim = np.minimum(np.maximum(aim, self._lower), self._upper)
        aim_v = _clipped((aim - self._aim) / GRID_S, speed)
        aim_a = _clipped((aim_v - self._aim_v) / GRID_S, hardest)
        # Where there is no error, this is the aim's own motion.
        catch_up = _braking_curve(self._aim - self._sent, _POSITION_GAIN, self._velocity_knee)
        wanted_v = _clipped(aim_v + catch_up, speed)
        error_v = wanted_v - self._v - GRID_S * aim_a
        catch_up = _braking_curve(error_v, _VELOCITY_GAIN, self._acceleration_knee)
        wanted_a = _clipped(aim_a + catch_up, hardest)
        change = _clipped(wanted_a - self._a, self._jerk_step)
        wanted_a = self._within_speed(self._a + change)
        self._a = self._guard.within(self._sent, self._v, self._a, wanted_a)
        self._v = self._v + GRID_S * self._a
        self._sent = self._sent + GRID_S * self._v
        self._aim, self._aim_v = aim, aim_v
        return self._sent

    def _within_speed(self, acceleration: Array) -> Array:
        """The acceleration, or less of it if the speed could not be kept after it.

        Taken back by one tick's jerk j each tick, an acceleration a adds to the speed, in steps of
        the grid, a + (a - j) + (a - 2 j) + ... = (n + 1) a - j n (n + 1) / 2 with n = floor(a / j).
        The largest that fits into what is left of the speed is the inverse of this.
        """
        sign, j = np.sign(acceleration), self._jerk_step
        left = np.maximum((self._speed - sign * self._v) / GRID_S, 0.0)
        n = np.floor(0.5 * (np.sqrt(1.0 + 8.0 * left / j) - 1.0))
        largest = (left + 0.5 * j * n * (n + 1.0)) / (n + 1.0)
        return sign * np.minimum(np.abs(acceleration), largest)


def _clipped(value: Array, bound: Array) -> Array:
    return np.minimum(np.maximum(value, -bound), bound)


def _braking_curve(error: Array, gain: float, knee: Array) -> Array:
    """Rate by which to make up for an error: gain times it, and beyond the knee what can be braked.

    Beyond the knee it is the curve sqrt(2 d (|error| - knee / 2)) of a motion that brakes with
    d = gain^2 knee; both parts have the same slope there. Never more than gain times the error.
    """
    size = np.abs(error)
    beyond = np.sqrt(knee * np.maximum(2.0 * size - knee, knee))
    return np.copysign(gain * np.minimum(size, beyond), error)
