"""What is known of a robot and its scene, as simulated arms use it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from skewmi.calibration.calibration_file import Calibration, read_calibration
from skewmi.calibration.calibration_use import servo_constants
from skewmi.errors import ConfigurationError
from skewmi.robot_models.feed_forward import FeedForward


@dataclass(frozen=True)
class Known:
    """A calibration in use.

    Attributes:
        calibration: As given.
    """

    calibration: Calibration

    @staticmethod
    def of(given: Calibration | str | Path | None) -> Known | None:
        """From what users and run directories give.

        Args:
            given: A calibration, its file, or the JSON of one; None if nothing is known.

        Raises:
            NotFoundError: There is no such file.
            ConfigurationError: It is no calibration of this robot model.
        """
        if given is None:
            return None
        if isinstance(given, Calibration):
            return Known(given)
        if isinstance(given, str) and given.lstrip().startswith("{"):
            try:
                return Known(Calibration.of_mapping(json.loads(given)))
            except (ValueError, ConfigurationError) as error:
                raise ConfigurationError(f"calibration: {error}") from error
        if not isinstance(given, str | Path):
            raise ConfigurationError(f"calibration is {given!r}; give a calibration file")
        return Known(read_calibration(given))

    def to_json(self) -> str:
        """One line that `of` reads back as an equal calibration."""
        return json.dumps(self.calibration.as_mapping())

    def feed_forward(self) -> FeedForward | None:
        """Of the servos, without limits; None if they were not calibrated."""
        constants = servo_constants(self.calibration)
        return None if constants is None else FeedForward(constants, None)
