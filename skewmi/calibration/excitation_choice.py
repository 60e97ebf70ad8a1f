"""Which excitation to make: the one of several that would tell the servos best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from skewmi.calibration.clear_space import ClearSpace
from skewmi.calibration.excitation import Excitation
from skewmi.calibration.prediction import LIKELY_DELAY_S, PredictedHalfWidth, predicted_half_width
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.robot_models import yumi
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.limits import JointLimits
from skewmi.robot_models.servo import ServoParameters
from skewmi.trajectory import Array, JointTrajectory

LIFT_M = 0.15
"""How far above where the table's tasks start the hand is while the joints are excited, m."""
TRIED = 4
"""Seeds that are compared."""
JUDGED_S = 20.0
"""Length of a motion by which its seed is judged, s: its tones are those of the whole motion."""


@dataclass(frozen=True, eq=False)
class ChosenExcitation:
    """A motion and what it would tell.

    Attributes:
        motion: To be made.
        seed: Of its tones.
        predicted: Half-widths that identification would come to if the servos were nominal.
    """

    motion: JointTrajectory
    seed: int
    predicted: PredictedHalfWidth


@cache
def excitation_centre() -> Array:
    """Where excitations begin and end: the table's tasks' start, lifted, rad. Shape (7,)."""
    kinematics = ArmKinematics("right")
    start = np.array(yumi.TABLE_CONFIGURATION)
    position, rotation = kinematics.forward(start)
    lifted = position + np.array([0.0, 0.0, LIFT_M])
    q = kinematics.inverse(lifted, rotation, start, max_iterations=30).q
    q.flags.writeable = False
    return q


def choose_excitation(
    asked: Excitation,
    limits: JointLimits,
    space: ClearSpace,
    model: ServoModel,
    nominal: ServoParameters,
    *,
    tell: Callable[[str], None] = lambda text: None,
) -> ChosenExcitation:
    """The best of `TRIED` seeds from the one that was asked for.

    Args:
        asked: Length, first seed, joints.
        limits: To keep.
        space: To stay in.
        model: That the servos will be identified with.
        nominal: What they are taken for.
        tell: Told in words how far it is.

    Raises:
        ConfigurationError: There is no room for any.
    """
    likely = DelayedServo(nominal, LIKELY_DELAY_S)
    centre = excitation_centre()
    judged = replace(asked, seconds=min(asked.seconds, JUDGED_S))
    widths: dict[int, float] = {}
    for seed in range(asked.seed, asked.seed + TRIED):
        motion = replace(judged, seed=seed).motion(centre, limits, space)
        widths[seed] = predicted_half_width(model, motion, likely).worst
        tell(f"motion with seed {seed}: worst predicted half-width {widths[seed]:.3g}")
    best = min(widths, key=lambda seed: widths[seed])
    motion = replace(asked, seed=best).motion(centre, limits, space)
    return ChosenExcitation(motion, best, predicted_half_width(model, motion, likely))
