"""Joint limits at a fraction of the speed."""

from __future__ import annotations

from dataclasses import replace

from skewmi.robot_models.limits import JointLimits


def slowed(limits: JointLimits, speed: float) -> JointLimits:
    """The same limits with less velocity. Acceleration and jerk stay, as `--speed` leaves them."""
    return replace(limits, velocity=speed * limits.velocity)
