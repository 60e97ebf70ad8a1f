"""What a step did to robot and scene, beyond what a policy sees."""

from __future__ import annotations

from dataclasses import dataclass

from skewmi.policy_io import Array


@dataclass(frozen=True)
class Diagnostics:
    """What the last step did to robot and scene. Each shape (num_envs,).

    Attributes:
        hand_force_peak: Largest net contact force on hand and wrist over the substeps, N.
        hand_force_mean: Mean over the substeps of that force's size, N.
        arm_force_peak: Largest net contact force on the arm without its hand, N.
        hand_tilt: Angle between the hand and the orientation it should hold, rad.
        hand_to_command: Distance of the measured hand from the commanded one, m.
    """

    hand_force_peak: Array
    hand_force_mean: Array
    arm_force_peak: Array
    hand_tilt: Array
    hand_to_command: Array
