"""How fast a run is: the joint limits to plan with, and how long a control step takes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from skewmi.policy_io import PolicyLayout
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models.feed_forward import ServoConstants, followable
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import CYCLE_NS


@dataclass(frozen=True)
class Pace:
    """How long a control step takes."""

    step_cycles: int
    """Planner cycles that it takes."""
    speed: float
    """Fraction of the training's speed that this is."""
    note: str | None
    """Why it is less than was asked for; None if it is not."""


def choose_pace(layout: PolicyLayout, speed: float, hand_speed: float, limits: str) -> Pace:
    """The pace nearest to the one that was asked for, and no faster.

    Args:
        layout: Its actions and control step say how fast the policy may ask the hand to move.
        speed: Fraction of the training's speed that was asked for.
        hand_speed: What the joint limits allow the hand, m/s.
        limits: Name of the profile that those limits are from.
    """
    followed = followed_speed(layout, speed, hand_speed)
    cycles = action_cycles(layout.control_dt, followed)
    executed = layout.control_dt * 1e9 / (cycles * CYCLE_NS)
    if executed >= speed:
        return Pace(cycles, executed, None)
    why = "control steps take whole cycles of 20 ms"
    if followed < speed:
        why = f"limits {limits} allow the hand {1e3 * hand_speed:.0f} mm/s"
    longer = 1.0 / executed
    note = f"{why}: every control step takes {longer:.1f} times as long as in training"
    return Pace(cycles, executed, note)


def planning_limits(
    profile: str, speed: float, servos: ServoConstants | None = None
) -> JointLimits:
    """The joint limits to plan with: a profile's, with no more than a fraction of full velocity,
    and no more acceleration and jerk than known servos can be made to follow.

    Full velocity is that of the fastest profile, so that a slow profile is not slowed down a
    second time. Acceleration and jerk stay: a slower robot shall not need longer to stop.

    Args:
        profile: Name of the profile.
        speed: Fraction of the training's speed, 0..1.
        servos: Of the robot, if they are known.

    Raises:
        NotFoundError: No such profile.
    """
    limits = joint_limits.profile(profile)
    if servos is not None:
        limits = followable(limits, servos)
    full = np.max([other.velocity for other in joint_limits.PROFILES.values()], axis=0)
    return replace(limits, velocity=np.minimum(limits.velocity, speed * full))


def followed_speed(layout: PolicyLayout, speed: float, hand_speed: float) -> float:
    """The fraction of the training's speed at which the hand can follow full actions.

    Args:
        layout: Its actions and control step say how fast the policy may ask the hand to move.
        speed: The fraction that was asked for.
        hand_speed: What the joint limits allow the hand, m/s.

    Returns:
        `speed`, or less.
    """
    asked = float(layout.action_scale[:3].max()) / layout.control_dt
    return min(speed, hand_speed / asked)


def action_cycles(control_dt: float, speed: float) -> int:
    """Planner cycles that a control step takes, at a fraction of the training's speed or slower."""
    return math.ceil(control_dt * 1e9 / CYCLE_NS / speed - 1e-6)
