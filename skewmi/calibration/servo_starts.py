"""Where the search for servos begins, and where it looks again."""

from __future__ import annotations

from itertools import product

import numpy as np

from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_parameters import ServoUnknowns
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.robot_models.yumi import Array

SUCH_DELAYS_S = (0.0, 0.012, 0.024, 0.036, 0.048, 0.060, 0.080)
SUCH_FRICTIONS = (0.1, 0.5, 1.0, 2.0)
SUCH_STIFFNESSES = (0.5, 1.0)
"""Starts that are tried: delays, N m, and factors on the nominal stiffness and damping."""
OTHER_STIFFNESSES = (0.25, 0.5, 0.7, 1.4, 2.0, 4.0)
"""Factors on the stiffness that are tried once a minimum is found, the ratios to it as they are."""
SUCH_STIFFNESSES_AGAIN = (0.45, 0.75, 1.2, 1.6)
SUCH_LEADS_AGAIN = (0.5, 1.0, 2.0, 3.0)
SUCH_FRICTIONS_AGAIN = (0.05, 0.3, 0.8, 1.6)
"""And factors on stiffness and damping ratio, and N m, of the servos that are tried then."""


def first_start(model: ServoModel, unknowns: ServoUnknowns, recording: ServoRecording) -> Array:
    """The best of a grid of servos, each joint by itself.

    Joints hardly move one another, so that each takes the servo that suits it: the search
    over all starts of seven joints is one over those of one.

    Args:
        model: That candidates are simulated with.
        unknowns: What vectors mean.
        recording: A short one.

    Returns:
        Shape (p,).
    """
    nominal = unknowns.nominal
    servos = [
        nominal.with_changes(
            kp=factor * nominal.kp,
            kd=factor * nominal.kd,
            frictionloss=np.full(7, friction),
        )
        for factor in SUCH_STIFFNESSES
        for friction in SUCH_FRICTIONS
    ]
    size = np.empty((len(SUCH_DELAYS_S), len(servos), 7))
    for row, delay in zip(size, SUCH_DELAYS_S, strict=True):
        late = [DelayedServo(parameters, delay) for parameters in servos]
        row[:] = ((model.positions(late, recording) - recording.positions) ** 2).mean(axis=1)
    # Each joint's errors by their smallest: a stiff one's count as much as a soft one's.
    least = size.min(axis=1)
    delay = int(np.argmin((least / least.min(axis=0)).sum(axis=1)))
    own = size[delay].argmin(axis=0)
    chosen = {
        name: np.array([getattr(servos[k], name)[joint] for joint, k in enumerate(own)])
        for name in ("kp", "kd", "frictionloss")
    }
    return unknowns.vector(DelayedServo(nominal.with_changes(**chosen), SUCH_DELAYS_S[delay]))


def other_starts(unknowns: ServoUnknowns, vector: Array) -> Array:
    """Other vectors with the same delay: stiffer and softer ones with the same ratios, and a
    grid of servos. Shape (p, k)."""
    columns = []
    for factor in OTHER_STIFFNESSES:
        columns.append(vector.copy())
        columns[-1][:7] += np.log(factor)
    nominal = unknowns.nominal
    here = unknowns.servo(vector)
    for stiffness, damping, friction in product(
        SUCH_STIFFNESSES_AGAIN, SUCH_LEADS_AGAIN, SUCH_FRICTIONS_AGAIN
    ):
        parameters = here.parameters.with_changes(
            kp=stiffness * nominal.kp,
            kd=stiffness * damping * nominal.kd,
            frictionloss=np.full(7, friction),
        )
        columns.append(unknowns.vector(DelayedServo(parameters, here.delay_s)))
    low, high = unknowns.bounds()
    return np.clip(np.array(columns).T, low[:, None], high[:, None])
