"""From an identification of an arm behind EGM to what a calibration file says of it."""

from __future__ import annotations

import numpy as np

from skewmi.calibration.calibration_parts import Constant, ServoCalibration
from skewmi.calibration.egm_identification import EgmIdentification
from skewmi.calibration.egm_law import EgmLaw
from skewmi.calibration.egm_model import EgmArm
from skewmi.calibration.egm_part import EgmCalibration
from skewmi.calibration.servo_section import LONG_MEMORY, constant_of, servo_start
from skewmi.robot_models import yumi
from skewmi.robot_models.servo import ServoParameters

_WORDS = {
    "gain": ("the law's gain", "1/s", 1.0),
    "low_pass": ("the corner of the law's low-pass", "Hz", 1.0),
    "delay": ("the lag that all joints share", "ms", 1e3),
}
_OF_JOINTS = {
    "lag": ("lag", "ms", 1e3),
    "kp": ("kp", "N m/rad", 1.0),
    "kd": ("kd", "N m s/rad", 1.0),
    "frictionloss_over_kp": ("frictionloss_over_kp", "rad", 1.0),
}


def egm_section(found: EgmIdentification) -> EgmCalibration:
    """Every constant with its interval; the armature is marked as assumed."""
    estimates = found.estimates
    armature = tuple(found.arm.servo.parameters.armature.tolist())
    names = ("kp", "kd", "frictionloss", "kd_over_kp", "frictionloss_over_kp")
    return EgmCalibration(
        period_ms=1e3 * found.period_s,
        speed_share=found.speed_share,
        gain=constant_of(estimates["gain"]),
        low_pass_hz=constant_of(estimates["low_pass"]),
        lag_ms=constant_of(estimates["lag"], 1e3),
        servo=ServoCalibration(
            **{name: constant_of(estimates[name]) for name in names},
            armature=Constant(armature, armature, armature, (True,) * 7),
            delay_ms=constant_of(estimates["delay"], 1e3),
        ),
    )


def egm_arm(section: EgmCalibration, nominal: ServoParameters) -> EgmArm:
    """The arm that a calibration file tells of.

    Args:
        section: Of the file.
        nominal: What no calibration tells.
    """
    law = EgmLaw(section.gain.value[0], section.low_pass_hz.value[0])
    return EgmArm(law, servo_start(section.servo, nominal))


def egm_warnings(found: EgmIdentification) -> tuple[str, ...]:
    """What whoever uses the constants should know, a sentence each."""
    joints, estimates = yumi.joint_names("right"), found.estimates
    warnings = []
    for name, (words, unit, factor) in _WORDS.items():
        estimate = estimates[name]
        if not estimate.identified[0]:
            low, high = factor * estimate.low[0], factor * estimate.high[0]
            warnings.append(f"{words} is not identified: {low:.3g} to {high:.3g} {unit}")
    for name, (words, unit, factor) in _OF_JOINTS.items():
        estimate = estimates[name]
        warnings += [
            f"{words} of {joint} is not identified: {factor * low:.3g} to {factor * high:.3g} "
            f"{unit}"
            for joint, known, low, high in zip(
                joints, estimate.identified, estimate.low, estimate.high, strict=True
            )
            if not known
        ]
    warnings += [
        f"{what} is at the end of what is searched: it may be beyond, and the others off by that"
        for what in found.at_the_end
    ]
    for joint, memory, rms in zip(
        joints, found.autocorrelation_time, found.residual_rms, strict=True
    ):
        if memory > LONG_MEMORY * _PER_STATE:
            warnings.append(
                f"the residual of {joint} ({rms:.2g} rad) hangs together over {memory:.0f} cycles: "
                "the arm does something that the model lacks; intervals are widened for it"
            )
    return tuple(warnings)


_PER_STATE = 5.0
"""Cycles for each of the states that `LONG_MEMORY` counts."""


def law_is_known(found: EgmIdentification) -> bool:
    """Whether lags and law are known: what feed-forward needs of it."""
    needed = (*_WORDS, "lag")
    return all(bool(np.all(found.estimates[name].identified)) for name in needed)
