"""How hard a robot touches its surroundings: what is measured, and what counts as gentle.

Simulation, evaluation and deployment measure the same quantities under the same names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

STANDING_S = 0.5
"""Time over which a standing force is averaged, s: where ISO/TS 15066 draws the line between
transient and quasi-static contact."""


@dataclass(frozen=True)
class Quantity:
    """One measured size."""

    label: str
    """For people."""
    limit: float | None
    """Largest value of a gentle step, in the unit of the quantity's name; None sets none."""


QUANTITIES: Mapping[str, Quantity] = {
    "hand_force_peak_n": Quantity("hand force, peak [N]", 100.0),
    "hand_force_mean_n": Quantity("hand force, mean of a step [N]", None),
    "hand_force_standing_n": Quantity("hand force, mean of 0.5 s [N]", 40.0),
    "arm_force_peak_n": Quantity("arm force, peak [N]", None),
    "hand_tilt_deg": Quantity("hand tilt [deg]", 2.0),
    "outside_box_mm": Quantity("hand outside its box [mm]", 3.0),
    "hand_to_command_mm": Quantity("hand to its command [mm]", None),
}
"""What is measured, by key of the JSON documents, which ends with the unit.

The peak is what the hand hits with, the standing force what it leans with. Forces on the arm leave
the hand out. The box is the workspace that commands are clipped to.
"""
