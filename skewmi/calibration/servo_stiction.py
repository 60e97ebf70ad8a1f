"""Friction at rest beside the other constants, where without it residuals hang together.

Friction that falls with speed looks like less damping: a model without it finds kd / kp and the
delay wrong, with intervals as narrow as if it were right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from skewmi.calibration.servo_fit import ServoFit
from skewmi.calibration.servo_model import ServoModel
from skewmi.calibration.servo_parameters import ServoUnknowns
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.servo_rivals import log_squares, losses
from skewmi.calibration.servo_search import LOOK_S, beginning
from skewmi.calibration.servo_starts import best_joints, later
from skewmi.robot_models.yumi import Array

CLEARLY_BETTER = 28.0
"""Log likelihood that friction at rest has to bring: twice as much as it has numbers."""
DELAYS_BESIDE_S = (0.0, -0.0006, 0.0006, -0.0015, 0.0015)
STIFFNESSES = (0.75, 1.0, 1.3)
"""Factors on what was found."""
MORE_AT_REST = (0.25, 0.8)
"""Of the friction in motion."""
VELOCITIES = (-1.0, 0.0, 1.0)
"""Logarithms, see `ServoUnknowns`."""
ITERATIONS_ON_PART, ITERATIONS, LAST_ITERATIONS = 8, 4, 4


@dataclass(frozen=True, eq=False)
class StickingFit:
    """What was found.

    Attributes:
        fit: With friction at rest among its unknowns.
        vector: Shape (p,).
    """

    fit: ServoFit
    vector: Array


def fit_stiction(
    model: ServoModel,
    recordings: Sequence[ServoRecording],
    plain: ServoUnknowns,
    vector: Array,
    residual: Array,
) -> StickingFit | None:
    """Fit friction at rest, too.

    Args:
        model: That candidates are simulated with.
        recordings: Of one arm.
        plain: Unknowns without it.
        vector: Found with them. Shape (p,).
        residual: Of it, rad. Shape (m, 7).

    Returns:
        None if that says the motion hardly any better.
    """
    unknowns = replace(plain, sticks=True)
    begin = plain.servo(vector)
    part = ServoFit(model, (beginning(recordings[0], LOOK_S),), unknowns)
    found, squares = _descended(part, _starts(unknowns, unknowns.vector(begin)))
    order = log_squares(squares).sum(axis=0).argsort()[:2]
    whole = ServoFit(model, recordings, unknowns)
    found, squares = whole.joints_fitted(found[:, order], ITERATIONS)
    best = found[:, log_squares(squares).sum(axis=0).argmin()]
    best = whole.descended(best, LAST_ITERATIONS)
    loss = losses(whole.squares(best[:, None]), residual).sum()
    return StickingFit(whole, best) if loss < -CLEARLY_BETTER else None


def _starts(unknowns: ServoUnknowns, vector: Array) -> list[Array]:
    """At each of several delays vectors with several frictions at rest. Each shape (p, k)."""
    parts = []
    for delay in DELAYS_BESIDE_S:
        moved = later(unknowns, vector, delay)
        columns = [moved]
        for stiffer, more, speed in product(STIFFNESSES, MORE_AT_REST, VELOCITIES):
            column = moved.copy()
            column[:7] += np.log(stiffer)
            # What was found is between friction at rest and in motion.
            column[14:21] /= 1.0 + more / 2.0
            column[-15:-8] = more * column[14:21]
            column[-8:-1] = speed
            columns.append(column)
        low, high = unknowns.bounds()
        parts.append(np.clip(np.column_stack(columns), low[:, None], high[:, None]))
    return parts


def _descended(fit: ServoFit, parts: list[Array]) -> tuple[Array, Array]:
    """The best at each delay, each joint from its best start; and their joints' squares."""
    vectors = np.concatenate(parts, axis=1)
    many = parts[0].shape[1]
    groups = [range(k * many, (k + 1) * many) for k in range(len(parts))]
    best, _ = best_joints(vectors, fit.squares(vectors), groups)
    return fit.joints_fitted(best, ITERATIONS_ON_PART)
