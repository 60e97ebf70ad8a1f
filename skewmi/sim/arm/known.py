"""What is known of a robot and its scene, as simulated arms use it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skewmi.box_frame import box_displacement, known_stiffness
from skewmi.calibration.calibration_file import Calibration, read_calibration
from skewmi.calibration.calibration_use import (
    LARGEST_LID_BIAS,
    lid_bias,
    require_robot,
    servo_constants,
)
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array, Workspace
from skewmi.robot_models.feed_forward import FeedForward
from skewmi.sim.arm.arm_task import SensedJoint


@dataclass(frozen=True)
class Known:
    """A calibration in use.

    Attributes:
        calibration: As given.
    """

    calibration: Calibration

    def __post_init__(self) -> None:
        require_robot(self.calibration, "sim")

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

    @property
    def displacement(self) -> tuple[float, float, float] | None:
        """Of the box, see `box_frame.box_displacement`."""
        return box_displacement(self.calibration)

    def stiffness(self, workspace: Workspace) -> Array | None:
        """Of the hand relative to training's, along the axes of a placed workspace.

        None if the servos were not calibrated.
        """
        return known_stiffness(self.calibration, workspace)

    def zero(self, joints: tuple[SensedJoint, ...], errors: Array | None) -> Array | None:
        """What to take off the readings of the scene's joints in an episode.

        Hinges alone have a zero: what the calibration says of the lid, or else what the first
        reading is off by, since it is known where the scene stands then.

        Args:
            joints: Of the scene.
            errors: Of the first reading, shape (n, joints); None if the sensors are ideal.

        Returns:
            In the joints' units, shape (n, joints) or (joints,); None if there is nothing.
        """
        hinges = np.array([joint.field.unit == "rad" for joint in joints])
        bias = lid_bias(self.calibration)
        if bias is not None:
            return np.where(hinges, bias, 0.0)
        if errors is None:
            return None
        zero: Array = np.where(hinges & (np.abs(errors) <= LARGEST_LID_BIAS), errors, 0.0)
        return zero
