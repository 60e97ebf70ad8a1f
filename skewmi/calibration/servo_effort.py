"""What efforts tell beyond positions: stiffness and damping in N m, whatever the masses are.

Positions tell stiffness, damping and friction per inertia: a model that is 15 % too light finds
all three 15 % too small. A servo pushes with e = kp (x - q) - kd v, target x late; where the arm
is positions tell, so that kp and kd follow from its efforts by linear least squares, without any
inertia. Friction is its ratio to kp, from positions, times that. Offsets of the efforts are left
out: they are weight that the controller does not compensate, and sensors' zeros.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skewmi.calibration.servo_estimates import Estimate, is_known
from skewmi.calibration.servo_fit import SETTLE_S
from skewmi.calibration.servo_identification import ServoIdentification
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.uncertainty import TWO_SIDED_95, autocorrelation_time
from skewmi.errors import ConfigurationError
from skewmi.robot_models.yumi import Array
from skewmi.trajectory import GRID_S

LATEST_TICKS = 3
"""How late efforts may be told after the positions they belong to, ticks of 4 ms."""
SYSTEMATIC = 0.01
"""Standard deviation of what the fit does not see, as a part: an error of the delay, and what
happens between two measurements. Of a robot 15 % heavier than the model it was 0.014 and 0.025."""
PUSHING = 0.9
"""Part of the force limit beyond which a servo may be at it, and tells nothing."""
LEAST = 50
"""Measurements of a joint that is not at its force limit: a second of them."""


@dataclass(frozen=True, eq=False)
class EffortFit:
    """Stiffness and damping by efforts. Each shape (7,).

    Attributes:
        kp: N m/rad.
        kp_deviation: Its standard deviation, as a part of it.
        kd: N m s/rad.
        kd_deviation: Likewise.
    """

    kp: Array
    kp_deviation: Array
    kd: Array
    kd_deviation: Array


def fit_efforts(
    model: ServoModel, servo: DelayedServo, recordings: Sequence[ServoRecording]
) -> EffortFit:
    """Find what makes measured efforts of where the arm was.

    Args:
        model: That the servos were identified with.
        servo: As identified from positions: simulated, it is where the arm was.
        recordings: That have efforts.

    Raises:
        ConfigurationError: A recording has no efforts, a joint is at its force limit nearly
            always, or its efforts do not grow with what its servo is off its target.
    """
    for recording in recordings:
        if recording.efforts is None:
            raise ConfigurationError(
                "a recording has no efforts, as of a robot that does not tell them; leave out "
                "--effort"
            )
    pushed = [
        (*model.errors(servo, r.commands, r.start), model.positions([servo], r)[0])
        for r in recordings
    ]
    fits = [_fit(recordings, pushed, ticks, servo) for ticks in range(LATEST_TICKS + 1)]
    fit, _ = min(fits, key=lambda each: each[1])
    wrong = np.flatnonzero(~((fit.kp > 0.0) & (fit.kd > 0.0)))
    if wrong.size:
        raise ConfigurationError(
            f"the efforts of joints {(wrong + 1).tolist()} of the chain do not grow with what "
            "their servos are off their targets; are they in N m, of these joints, with the sign "
            "of the positions?"
        )
    return fit


def with_efforts(found: ServoIdentification, fit: EffortFit) -> ServoIdentification:
    """What was identified from positions, its constants in N m by the efforts.

    The servos that reproduce the motion with the model's inertia stay as they are.
    """
    estimates = dict(found.estimates)
    for name, value, deviation in (
        ("kp", fit.kp, fit.kp_deviation),
        ("kd", fit.kd, fit.kd_deviation),
    ):
        half = TWO_SIDED_95 * deviation
        low, high = value * np.exp(-half), value * np.exp(half)
        estimates[name] = Estimate(value, low, high, is_known(name, value, low, high, fit.kp))
    ratio = found.estimates["frictionloss_over_kp"]
    value = fit.kp * ratio.value
    half = np.hypot(fit.kp * (ratio.high - ratio.value), TWO_SIDED_95 * fit.kp_deviation * value)
    low, high = np.maximum(value - half, 0.0), value + half
    known = is_known("frictionloss", value, low, high, fit.kp)
    estimates["frictionloss"] = Estimate(value, low, high, known)
    if (stiction := estimates.get("stiction")) is not None:
        # Positions tell it as an angle.
        more = fit.kp / found.estimates["kp"].value
        estimates["stiction"] = replace(
            stiction,
            value=more * stiction.value,
            low=more * stiction.low,
            high=more * stiction.high,
        )
    return replace(found, estimates=estimates)


def _fit(
    recordings: Sequence[ServoRecording],
    pushed: Sequence[tuple[Array, Array, Array]],
    late_ticks: int,
    servo: DelayedServo,
) -> tuple[EffortFit, float]:
    """For efforts so late; and how far they are off, as a part of themselves."""
    values, deviations, badness = np.empty((7, 2)), np.empty((7, 2)), 0.0
    limit = PUSHING * servo.parameters.force_limit
    for joint in range(7):
        parts = [
            _rows(recording, error, velocity, simulated, joint, late_ticks)
            for recording, (error, velocity, simulated) in zip(recordings, pushed, strict=True)
        ]
        matrix = np.concatenate([part[0] for part in parts])
        told = np.concatenate([part[1] for part in parts])
        free = np.concatenate([np.abs(part[2]) < limit[joint] for part in parts])
        if free.sum() < LEAST:
            raise ConfigurationError(
                f"joint {joint + 1} of the chain is at its force limit of "
                f"{servo.parameters.force_limit[joint]:g} N m in all but {free.sum()} of "
                f"{len(free)} measurements, of which {LEAST} are needed; leave out --effort"
            )
        matrix, told = matrix[free], told[free]
        information = matrix.T @ matrix
        values[joint] = np.linalg.solve(information, matrix.T @ told)
        residual = told - matrix @ values[joint]
        variance = float(residual @ residual) / max(len(residual) - 3, 1)
        covariance = variance * autocorrelation_time(residual) * np.linalg.inv(information)
        seen = np.sqrt(np.diag(covariance)) / np.abs(values[joint])
        deviations[joint] = np.hypot(seen, SYSTEMATIC)
        badness += variance / max(float(told @ told) / len(told), 1e-30)
    (kp, kd), (kp_deviation, kd_deviation) = values.T, deviations.T
    return EffortFit(kp, kp_deviation, kd, kd_deviation), badness


def _rows(
    recording: ServoRecording,
    error: Array,
    velocity: Array,
    simulated: Array,
    joint: int,
    late_ticks: int,
) -> tuple[Array, Array, Array]:
    """Of one joint while it moves: what multiplies kp and kd, and the effort, each less its mean;
    and the effort itself. Shapes (m, 2), (m,), (m,)."""
    assert recording.efforts is not None
    rows = recording.times_s >= recording.motion_begins_s + SETTLE_S
    error, velocity, simulated = (each[:, joint] for each in (error, velocity, simulated))
    at = recording.times_s[rows] - GRID_S * late_ticks
    ticks = GRID_S * np.arange(len(error))
    # Where the arm was and how fast, not where the model has it: that hardly differs in some ticks.
    off = recording.positions[rows, joint] - simulated[rows]
    faster = np.gradient(off, recording.times_s[rows])
    errors = np.interp(at, ticks, error) - off
    matrix = np.stack((errors, -np.interp(at, ticks, velocity) - faster), axis=1)
    effort = recording.efforts[rows, joint]
    return matrix - matrix.mean(axis=0), effort - effort.mean(), effort
