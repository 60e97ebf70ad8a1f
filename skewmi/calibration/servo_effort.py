"""What efforts tell beyond positions: how much inertia there is, and so the constants in N m.

Positions tell stiffness, damping and friction per inertia: a model that is 15 % too light finds
all three 15 % too small. Its servos then push 15 % too weakly, at every moment; so the slope of
measured over simulated effort of a joint is the factor that its constants lack. Offsets are left
out: they are weight that the controller does not compensate, and sensors' zeros.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skewmi.calibration.servo_estimates import Estimate, is_known
from skewmi.calibration.servo_identification import SETTLE_S, ServoIdentification
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.uncertainty import TWO_SIDED_95, autocorrelation_time
from skewmi.errors import ConfigurationError
from skewmi.robot_models.yumi import Array
from skewmi.trajectory import GRID_S

LATEST_TICKS = 3
"""How late efforts may be told after the positions they belong to, ticks of 4 ms."""
PUSHING = 0.9
"""Part of the force limit beyond which a servo may be at it: no slope is to be had there."""


@dataclass(frozen=True, eq=False)
class EffortScale:
    """By what the constants of a joint are to be multiplied.

    Attributes:
        value: Shape (7,).
        deviation: Standard deviation, as a part of the value. Shape (7,).
    """

    value: Array
    deviation: Array


def effort_scale(
    model: ServoModel,
    servo: DelayedServo,
    recordings: Sequence[ServoRecording],
) -> EffortScale:
    """Compare measured efforts with those of identified servos.

    Args:
        model: That they were identified with.
        servo: As identified from positions.
        recordings: That have efforts.

    Raises:
        ConfigurationError: A recording has no efforts, or those of a joint do not follow its
            motion at all.
    """
    for recording in recordings:
        if recording.efforts is None:
            raise ConfigurationError(
                "a recording has no efforts, as of a robot that does not tell them; leave out "
                "--effort"
            )
    simulated = [model.torques(servo, r.commands, r.start) for r in recordings]
    late = min(
        range(LATEST_TICKS + 1),
        key=lambda ticks: _fit(recordings, simulated, ticks, servo)[2],
    )
    slope, deviation, _ = _fit(recordings, simulated, late, servo)
    wrong = np.flatnonzero(~(slope > 0.0))
    if wrong.size:
        raise ConfigurationError(
            f"the efforts of joints {(wrong + 1).tolist()} of the chain do not grow with what "
            "their servos push; are they in N m, of these joints, with the sign of the positions?"
        )
    return EffortScale(slope, deviation / slope)


def with_efforts(found: ServoIdentification, scale: EffortScale) -> ServoIdentification:
    """What was identified from positions, its constants in N m by the efforts.

    The servos that reproduce the motion with the model's inertia stay as they are.
    """
    kp = scale.value * found.estimates["kp"].value
    estimates = dict(found.estimates)
    for name in ("kp", "kd", "armature"):
        if name in estimates:
            one = estimates[name]
            value = scale.value * one.value
            half = np.hypot(np.log(one.high / one.value), TWO_SIDED_95 * scale.deviation)
            low, high = value * np.exp(-half), value * np.exp(half)
            estimates[name] = Estimate(value, low, high, is_known(name, value, low, high, kp))
    one = estimates["frictionloss"]
    value = scale.value * one.value
    half = np.hypot(scale.value * (one.high - one.value), TWO_SIDED_95 * scale.deviation * value)
    low, high = np.maximum(value - half, 0.0), value + half
    known = is_known("frictionloss", value, low, high, kp)
    estimates["frictionloss"] = Estimate(value, low, high, known)
    return replace(found, estimates=estimates)


def _fit(
    recordings: Sequence[ServoRecording],
    simulated: Sequence[Array],
    late_ticks: int,
    servo: DelayedServo,
) -> tuple[Array, Array, float]:
    """Slopes, their standard deviations, and how far the efforts are off, in their own units."""
    slopes, deviations, badness = np.empty(7), np.empty(7), 0.0
    limit = PUSHING * servo.parameters.force_limit
    for joint in range(7):
        pairs = [
            _pairs(recording, torque[:, joint], joint, late_ticks)
            for recording, torque in zip(recordings, simulated, strict=True)
        ]
        # Each recording has an offset of its own.
        told = np.concatenate([a - a.mean() for a, _ in pairs])
        ours = np.concatenate([b - b.mean() for _, b in pairs])
        free = np.abs(np.concatenate([b for _, b in pairs])) < limit[joint]
        told, ours = told[free], ours[free]
        power = float(ours @ ours)
        slopes[joint] = float(ours @ told) / power
        residual = told - slopes[joint] * ours
        variance = float(residual @ residual) / max(len(residual) - 2, 1)
        memory = autocorrelation_time(residual)
        deviations[joint] = np.sqrt(variance * memory / power)
        badness += variance / max(float(told @ told) / len(told), 1e-30)
    return slopes, deviations, badness


def _pairs(
    recording: ServoRecording, torque: Array, joint: int, late_ticks: int
) -> tuple[Array, Array]:
    """Measured and simulated effort of a joint while it moves, N m."""
    assert recording.efforts is not None
    rows = recording.times_s >= recording.motion_begins_s + SETTLE_S
    ticks = GRID_S * np.arange(len(torque))
    at = recording.times_s[rows] - GRID_S * late_ticks
    return recording.efforts[rows, joint], np.interp(at, ticks, torque)
