"""How far estimates of a least squares fit may be off, with residuals that are not white.

The usual intervals (also `mujoco.sysid.calculate_intervals`) take every residual for a measurement
of its own. Residuals of a simulation are not that: what the model lacks stays for many samples, and
the interval comes out too narrow. Two estimates of the covariance are made here, and whoever asks
for a standard deviation gets the larger one:

* each joint's variance is multiplied by its residual's autocorrelation time, the number of samples
  that tell as much as one (1 for white noise);
* the scores' own covariance over lags of up to a second (Newey and West, Econometrica 55, 1987),
  which sees what residuals of several joints have in common and where in the motion they are large.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skewmi.robot_models.yumi import Array

TWO_SIDED_95 = 1.959964
"""Half-width of a 95 % interval in standard deviations."""

UNTOLD = 1e12
"""Variance of a parameter that nothing is known of (finite, so that sums of it are)."""


@dataclass(frozen=True, eq=False)
class FitCovariance:
    """Covariance of fitted parameters, twice, and other minima that are as good.

    Attributes:
        by_autocorrelation: Shape (p, p).
        by_scores: Shape (p, p).
        rivals: From the minimum to each other one that the data do not tell from it. Shape (p, k),
            or None if there is none.
    """

    by_autocorrelation: Array
    by_scores: Array
    rivals: Array | None = None

    def deviations(self, outputs: Array) -> Array:
        """Standard deviations of linear functions of the parameters.

        With rivals, they are such that a 95 % interval about the minimum holds those about them.

        Args:
            outputs: Derivative of each by each parameter. Shape (k, p).

        Returns:
            Shape (k,).
        """
        both = [
            np.einsum("ki,ij,kj->k", outputs, covariance, outputs)
            for covariance in (self.by_autocorrelation, self.by_scores)
        ]
        deviations: Array = np.sqrt(np.maximum(*both).clip(min=0.0))
        if self.rivals is not None:
            deviations += np.abs(outputs @ self.rivals).max(axis=1, initial=0.0) / TWO_SIDED_95
        return deviations


def fit_covariance(
    residual: Array, jacobian: Array, weight: Array, sigma: Array, lags: int
) -> FitCovariance:
    """Covariance of the parameters that minimise sum_j weight_j^2 sum_t residual_tj^2.

    Args:
        residual: At the minimum. Shape (m, d): samples in the order of time, joints.
        jacobian: Of the residual by the parameters. Shape (m, d, p).
        weight: Of each joint in the fit. Shape (d,).
        sigma: Standard deviation of each joint's residual. Shape (d,).
        lags: Samples over which residuals may hang together.

    Returns:
        `UNTOLD` on the diagonal where the motion does not tell a parameter at all.
    """
    parameters = jacobian.shape[-1]
    by_joint = np.einsum("tdp,tdq->dpq", jacobian, jacobian)
    information = np.einsum("d,dpq->pq", weight**2, by_joint)
    inverse = inverse_of(information)
    untold = np.diag(UNTOLD * (np.diag(information) <= 0.0))
    time = np.array([autocorrelation_time(column) for column in residual.T])
    spread = np.einsum("d,dpq->pq", weight**4 * sigma**2 * time, by_joint)
    scores = np.einsum("d,td,tdp->tp", weight**2, residual, jacobian)
    lags = min(lags, len(scores) // 10)
    meat = scores.T @ scores
    for lag in range(1, lags + 1):
        part = scores[lag:].T @ scores[:-lag]
        meat += (1.0 - lag / (lags + 1.0)) * (part + part.T)
    # A fit of p parameters makes its own residuals smaller than the errors are.
    meat *= residual.size / max(residual.size - parameters, 1)
    return FitCovariance(inverse @ spread @ inverse + untold, inverse @ meat @ inverse + untold)


def autocorrelation_time(series: Array) -> float:
    """Samples of a series that tell as much about its mean as one independent one; 1 at least.

    1 + 2 sum of the autocorrelations, up to where the sum of two neighbours is no longer positive
    (Geyer, Statistical Science 7, 1992): beyond it estimates are noise alone.
    """
    centred = series - series.mean()
    power = float(centred @ centred)
    if power <= 0.0:
        return 1.0
    n = len(centred)
    spectrum = np.abs(np.fft.rfft(centred, 2 * n)) ** 2
    correlation = np.fft.irfft(spectrum)[: n // 2] / power
    pairs = correlation[1 : len(correlation) // 2 * 2 - 1].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0.0)
    kept = pairs[: ends[0] if ends.size else len(pairs)]
    return max(1.0, 1.0 + 2.0 * float(kept.sum()))


def inverse_of(matrix: Array) -> Array:
    """Inverse of a symmetric matrix of rows of very different size; zero where they are."""
    size = np.sqrt(np.diag(matrix))
    told = size > 0.0
    inverse = np.zeros_like(matrix)
    scaled = matrix[np.ix_(told, told)] / np.outer(size[told], size[told])
    inverse[np.ix_(told, told)] = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True) / np.outer(
        size[told], size[told]
    )
    return inverse
