"""Where the search for servos begins, and where it looks again."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product

import numpy as np

from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_parameters import DELAY_UNIT_S, ServoUnknowns
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.robot_models.yumi import Array

SUCH_DELAYS_S = (0.0, 0.012, 0.024, 0.036, 0.048, 0.060, 0.080)
SUCH_FRICTIONS = (0.1, 0.5, 1.0, 2.0)
SUCH_STIFFNESSES = (0.5, 1.0)
"""Starts that are tried: delays, N m, and factors on the nominal stiffness and damping."""
STIFFNESSES, LEADS, FRICTIONS = (0.4, 1.0, 2.0), (0.5, 1.0, 2.0), (0.1, 1.0)
"""Of a grid at each delay: factors on nominal stiffness and damping ratio, and N m."""
SOFTER, STIFFER = (0.25, 0.5, 0.7), (1.4, 2.0, 4.0)
"""Factors on the stiffness that are tried once a minimum is found, the ratios to it as they are."""
STIFFNESSES_AGAIN = (0.45, 0.75, 1.2, 1.6)
LEADS_AGAIN = (0.5, 1.0, 2.0, 3.0)
FRICTIONS_AGAIN = (0.05, 0.3, 0.8, 1.6)
"""And a grid of servos that is tried then."""
_LEAST_LEAD_S = 1e-5


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


def start_grid(unknowns: ServoUnknowns, delay_s: float) -> tuple[Array, list[range]]:
    """Servos all over the range at one delay, shape (p, k), and the columns of each stiffness."""
    columns = servo_grid(unknowns, delay_s, STIFFNESSES, LEADS, FRICTIONS)
    size = columns.shape[1] // len(STIFFNESSES)
    return columns, [range(size * k, size * (k + 1)) for k in range(len(STIFFNESSES))]


def starts_around(
    unknowns: ServoUnknowns, vector: Array, *, grid: bool
) -> tuple[Array, list[range]]:
    """A vector and others with its delay: softer and stiffer ones with the same ratios.

    Args:
        unknowns: What vectors mean.
        vector: To look around. Shape (p,).
        grid: Whether servos all over the range come with them.

    Returns:
        Vectors, shape (p, k), and the columns of each kind; the first is the vector itself.
    """
    columns = [vector[:, None]]
    for factors in (SOFTER, STIFFER):
        others = np.tile(vector[:, None], (1, len(factors)))
        others[:7] += np.log(factors)
        columns.append(others)
    if grid:
        delay = unknowns.servo(vector).delay_s
        columns.append(servo_grid(unknowns, delay, STIFFNESSES_AGAIN, LEADS_AGAIN, FRICTIONS_AGAIN))
    ends = np.cumsum([0, *(part.shape[1] for part in columns)])
    low, high = unknowns.bounds()
    found = np.clip(np.concatenate(columns, axis=1), low[:, None], high[:, None])
    return found, [range(begin, end) for begin, end in pairwise(ends.tolist())]


def servo_grid(
    unknowns: ServoUnknowns,
    delay_s: float,
    stiffnesses: Sequence[float],
    leads: Sequence[float],
    frictions: Sequence[float],
) -> Array:
    """Every combination of factors on stiffness and kd / kp with frictions in N m. Shape (p, k)."""
    nominal = unknowns.nominal
    columns = [
        unknowns.vector(
            DelayedServo(
                nominal.with_changes(
                    kp=stiffness * nominal.kp,
                    kd=stiffness * lead * nominal.kd,
                    frictionloss=np.full(7, friction),
                ),
                delay_s,
            )
        )
        for stiffness, lead, friction in product(stiffnesses, leads, frictions)
    ]
    return np.array(columns).T


def later(unknowns: ServoUnknowns, vector: Array, delay_s: float) -> Array:
    """A vector with another delay and, by the damping, the same lag at a steady speed.

    Args:
        unknowns: What vectors mean.
        vector: Shape (p,).
        delay_s: More than it has, s.

    Returns:
        As far as the bounds admit. Shape (p,).
    """
    moved = vector.copy()
    moved[-1] += delay_s / DELAY_UNIT_S
    lead = unknowns.nominal.kd / unknowns.nominal.kp
    moved[7:14] = np.log(np.maximum(lead * np.exp(vector[7:14]) - delay_s, _LEAST_LEAD_S) / lead)
    within: Array = np.clip(moved, *unknowns.bounds())
    return within


def best_joints(
    vectors: Array, squares: Array, groups: Sequence[Sequence[int]]
) -> tuple[Array, Array]:
    """One vector of each group of columns, each joint's numbers from the column that suits it.

    Args:
        vectors: Those of a group have the same delay. Shape (p, k).
        squares: Of each joint's residual. Shape (7, k).
        groups: Columns of each.

    Returns:
        Vectors, shape (p, g), and their joints' squares, shape (7, g).
    """
    chosen = np.array([np.array(group)[squares[:, list(group)].argmin(axis=1)] for group in groups])
    kinds = (len(vectors) - 1) // 7
    numbers = vectors[:-1].reshape(kinds, 7, -1)[:, np.arange(7), chosen]
    numbers = numbers.transpose(0, 2, 1).reshape(7 * kinds, -1)
    delays = vectors[-1:, [group[0] for group in groups]]
    return np.concatenate((numbers, delays)), squares[np.arange(7), chosen].T
