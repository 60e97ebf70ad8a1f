"""From an identification to what a calibration file says of the servos."""

from __future__ import annotations

import numpy as np

from skewmi.calibration.calibration_file import Constant, ServoCalibration
from skewmi.calibration.calibration_parts import STICTION_CONSTANTS
from skewmi.calibration.servo_estimates import KNOWN_FRICTION, Estimate
from skewmi.calibration.servo_identification import ServoIdentification
from skewmi.calibration.servo_model import DelayedServo
from skewmi.calibration.stiction import Stiction
from skewmi.robot_models import yumi
from skewmi.robot_models.servo import ServoParameters

_UNITS = {
    "kp": "N m/rad",
    "kd": "N m s/rad",
    "frictionloss": "N m",
    "armature": "kg m^2",
    "kd_over_kp": "s",
    "frictionloss_over_kp": "rad",
}
_STICTION_UNITS = {"stiction": "N m", "stribeck_velocity": "rad/s"}
"""Of what is there if joints stick."""
STICKS = 0.1
"""More friction at rest, as a part of that in motion, from which a joint sticks."""
LONG_MEMORY = 10.0
"""Autocorrelation time of a residual, in samples, from which the model seems to lack something."""


def servo_section(found: ServoIdentification) -> ServoCalibration:
    """Every constant with its interval; the armature is marked as assumed unless identified."""
    constants = {name: constant_of(found.estimates[name]) for name in _UNITS if name != "armature"}
    armature = found.estimates.get("armature")
    if armature is None:
        values = tuple(found.servo.parameters.armature.tolist())
        constants["armature"] = Constant(values, values, values, (True,) * 7)
    else:
        constants["armature"] = constant_of(armature)
    if found.servo.stiction is not None:
        constants |= {name: constant_of(found.estimates[name]) for name in STICTION_CONSTANTS}
    return ServoCalibration(**constants, delay_ms=constant_of(found.estimates["delay"], 1e3))


def servo_start(section: ServoCalibration, nominal: ServoParameters) -> DelayedServo:
    """Servos of an earlier calibration, to begin a search from.

    Args:
        section: Of a calibration file.
        nominal: What no calibration tells.
    """
    stiction = None
    if section.stiction is not None and section.stribeck_velocity is not None:
        more, kp = np.array(section.stiction.value), np.array(section.kp.value)
        stiction = Stiction(more / kp, np.array(section.stribeck_velocity.value))
    return DelayedServo(
        nominal.with_changes(
            **{
                name: np.array(getattr(section, name).value)
                for name in ("kp", "kd", "frictionloss", "armature")
            }
        ),
        section.delay_ms.value[0] / 1e3,
        stiction,
    )


def servo_warnings(found: ServoIdentification) -> tuple[str, ...]:
    """What whoever uses the constants should know, a sentence each."""
    names = yumi.joint_names("right")
    warnings = []
    for name, unit in (_UNITS | _STICTION_UNITS).items():
        estimate = found.estimates.get(name)
        if estimate is None:
            continue
        warnings += [
            f"{name} of {joint} is not identified: {low:.3g} to {high:.3g} {unit}"
            for joint, known, low, high in zip(
                names, estimate.identified, estimate.low, estimate.high, strict=True
            )
            if not known
        ]
    if not found.estimates["delay"].identified[0]:
        warnings.append("the delay is not identified")
    warnings += _of_stiction(found.servo)
    for joint, memory, rms in zip(
        names, found.autocorrelation_time, found.residual_rms, strict=True
    ):
        if memory > LONG_MEMORY:
            warnings.append(
                f"the residual of {joint} ({rms:.2g} rad) hangs together over {memory:.0f} "
                "samples: the arm does something that the model lacks; intervals are widened for it"
            )
    return tuple(warnings)


def _of_stiction(servo: DelayedServo) -> list[str]:
    if servo.stiction is None:
        return []
    moving = servo.parameters.frictionloss
    more = servo.parameters.kp * servo.stiction.angle
    return [
        f"{joint} sticks: at rest its friction is {rest:.2g} N m more than in motion, which is all "
        f"that frictionloss tells; it falls at speeds of some {speed:.2g} rad/s"
        for joint, part, rest, speed in zip(
            yumi.joint_names("right"), moving, more, servo.stiction.velocity, strict=True
        )
        if rest > max(STICKS * part, KNOWN_FRICTION)
    ]


def constant_of(estimate: Estimate, factor: float = 1.0) -> Constant:
    """An estimate as a file has it, in the unit that the factor makes."""
    value, low, high = (
        tuple((factor * part).tolist()) for part in (estimate.value, estimate.low, estimate.high)
    )
    return Constant(value, low, high, (False,) * np.size(estimate.value))
