"""How late the arm is behind its commands, as far as the robot server has measured it."""

from __future__ import annotations

import math
from collections.abc import Mapping

from skewmi.deploy.robot.status import DELAY_KEY

MOST_S = 0.100
"""A longer delay is taken for this one: what is told must not reach far into the past."""

_SMOOTHING = 1.0 / 8.0
"""Of a status, ten of which come each second: a change has its effect within two seconds."""


class ArmDelay:
    """What statuses of the robot server tell of it, bounded and smoothed.

    A simulated robot tells none, and has none that is not its servos' own.

    Args:
        seconds: What it is until they tell, s.
    """

    def __init__(self, seconds: float = 0.0) -> None:
        self._seconds = min(max(seconds, 0.0), MOST_S)

    @property
    def ns(self) -> int:
        """From a command to the measurement that shows it."""
        return round(1e9 * self._seconds)

    def hear(self, told: Mapping[str, str]) -> None:
        """Take in what a status tells; what is no number changes nothing.

        Args:
            told: `RobotStatus.told`, of the robot server alone.
        """
        try:
            seconds = float(told.get(DELAY_KEY, "")) / 1e3
        except ValueError:
            return
        if math.isfinite(seconds):
            self._seconds += _SMOOTHING * (min(max(seconds, 0.0), MOST_S) - self._seconds)
