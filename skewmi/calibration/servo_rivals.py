"""Servos that data do not tell apart.

Vectors are compared by the likelihood of their residuals, each joint's with a size of its own:
m / 2 log(mean square) of m samples, by the autocorrelation time, because so many tell as much as
one. A vector that loses less than `TOLD_APART` by it is as good an answer as the best one, wherever
it is: an interval that does not hold it is too narrow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skewmi.calibration.servo_fit import RESOLUTION, ServoFit, autocorrelation_times
from skewmi.calibration.uncertainty import TWO_SIDED_95, FitCovariance
from skewmi.robot_models.yumi import Array

BETTER = 0.5
"""Log likelihood by which another vector has to be better to be gone to."""
TOLD_APART = TWO_SIDED_95**2 / 2.0
"""Loss of log likelihood at the ends of a 95 % interval."""
ITERATIONS = 4


def log_squares(squares: Array) -> Array:
    """Logarithms of mean squares of residuals, rad^2, of those that are noise at least."""
    logs: Array = np.log(np.maximum(squares, RESOLUTION**2))
    return logs


def losses(squares: Array, residual: Array) -> Array:
    """Log likelihood that each joint loses by other vectors than a reference.

    Args:
        squares: Mean squares of the joints' residuals with them, rad^2. Shape (7, k).
        residual: Of the reference, rad. Shape (m, 7).

    Returns:
        Shape (7, k).
    """
    own = log_squares((residual**2).mean(axis=0))
    telling = len(residual) / autocorrelation_times(residual)
    loss: Array = (telling / 2.0 * (log_squares(squares).T - own)).T
    return loss


def likely(vector: Array, vectors: Array, loss: Array) -> Array:
    """Vectors that data do not tell from a reference, or those joints of them.

    Args:
        vector: The reference. Shape (p,).
        vectors: Shape (p, k).
        loss: Of each joint's log likelihood by them. Shape (7, k).

    Returns:
        Shape (p, at most k). Joints that lose much have the reference's numbers if the delay is
        its, too: then each may be judged by itself.
    """
    same = np.equal(vectors[-1], vector[-1])
    kinds = len(vector) // 7
    joints = np.tile(loss >= TOLD_APART, (kinds, 1))
    mixed = vectors.copy()
    mixed[:-1] = np.where(joints & same, vector[:-1, None], vectors[:-1])
    found: Array = mixed[:, same | (loss.sum(axis=0) < TOLD_APART)]
    return found


def outside(vectors: Array, vector: Array, covariance: FitCovariance) -> NDArray[np.bool_]:
    """Which vectors are not within the 95 % intervals of the numbers of one. Shape (k,)."""
    half = TWO_SIDED_95 * covariance.deviations(np.eye(len(vector)))
    far: NDArray[np.bool_] = np.abs(vectors - vector[:, None]) > half[:, None]
    return np.asarray(far.any(axis=0))


def with_its_delay(vectors: Array, old: Array, new: Array) -> Array:
    """Vectors, of which those with the delay of an old one get that of a new one. Shape (p, k)."""
    moved: Array = vectors.copy()
    moved[-1, vectors[-1] == old[-1]] = new[-1]
    return moved


def remaining_rivals(fit: ServoFit, vector: Array, rivals: Array) -> tuple[Array, Array]:
    """What is left of rivals of a part of the motion on all of it.

    Args:
        fit: On all of it.
        vector: The best. Shape (p,).
        rivals: Shape (p, k).

    Returns:
        Those that are still not told apart, fitted, shape (p, k), and the log likelihood that each
        loses, shape (k,).
    """
    if not rivals.shape[1]:
        return rivals, np.zeros(0)
    residual = fit.residual(vector[:, None])[..., 0]
    fitted, squares = fit.joints_fitted(rivals, ITERATIONS)
    mixed = likely(vector, fitted, losses(squares, residual))
    if not mixed.shape[1]:
        return mixed, np.zeros(0)
    # What is mixed of several may be worth less than its joints are.
    loss = losses(fit.squares(mixed), residual).sum(axis=0)
    kept = loss < TOLD_APART
    return mixed[:, kept], loss[kept]
