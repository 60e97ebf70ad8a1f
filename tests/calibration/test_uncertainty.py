"""Intervals hold the truth as often as they say, also where residuals hang together."""

from __future__ import annotations

import numpy as np
import pytest

from skewmi.calibration.uncertainty import (
    TWO_SIDED_95,
    FitCovariance,
    autocorrelation_time,
    fit_covariance,
)


def correlated(rng: np.random.Generator, n: int, rho: float) -> np.ndarray:
    """A stationary autoregression of unit variance."""
    noise = np.sqrt(1.0 - rho * rho) * rng.standard_normal(n)
    series = np.empty(n)
    series[0] = rng.standard_normal()
    for k in range(1, n):
        series[k] = rho * series[k - 1] + noise[k]
    return series


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_the_autocorrelation_time_is_that_of_the_process(rho: float) -> None:
    rng = np.random.default_rng(3)
    found = np.mean([autocorrelation_time(correlated(rng, 2000, rho)) for _ in range(20)])
    assert found == pytest.approx((1.0 + rho) / (1.0 - rho), rel=0.15)


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_95_percent_intervals_hold_95_percent_of_the_truths(rho: float) -> None:
    """Of a straight line's two numbers, both 0, from two sensors of different noise."""
    rng = np.random.default_rng(4)
    n, size = 600, np.array([1.0, 0.1])
    t = np.linspace(0.0, 1.0, n)
    one = np.stack((np.ones(n), t), axis=1)
    jacobian = np.repeat(one[:, None, :], 2, axis=1)
    held = []
    for _ in range(150):
        noise = np.stack([s * correlated(rng, n, rho) for s in size], axis=1)
        rows = (jacobian / size[:, None]).reshape(-1, 2)
        error = np.linalg.lstsq(rows, (noise / size).ravel(), rcond=None)[0]
        residual = jacobian @ error - noise
        sigma = residual.std(axis=0, ddof=1)
        covariance = fit_covariance(residual, jacobian, 1.0 / size, sigma, lags=30)
        deviations = covariance.deviations(np.eye(2))
        held.append(np.abs(error) < TWO_SIDED_95 * deviations)
    assert 0.90 <= np.mean(held) <= 0.995


def test_an_interval_holds_those_of_minima_that_are_as_good() -> None:
    one, two = np.diag([0.01, 0.04]), np.diag([0.02, 0.03])
    alone = FitCovariance(one, two).deviations(np.eye(2))
    np.testing.assert_allclose(alone, np.sqrt([0.02, 0.04]))
    np.testing.assert_array_equal(
        FitCovariance(one, two, np.zeros((2, 0))).deviations(np.eye(2)), alone
    )
    rivals = np.array([[3.0, -1.0], [0.0, 0.5]])
    half = TWO_SIDED_95 * FitCovariance(one, two, rivals).deviations(np.eye(2))
    np.testing.assert_allclose(half, TWO_SIDED_95 * alone + [3.0, 0.5])


def test_what_the_motion_does_not_tell_has_a_hopeless_interval() -> None:
    rng = np.random.default_rng(5)
    jacobian = rng.standard_normal((200, 1, 3))
    jacobian[..., 1] = 0.0
    residual = rng.standard_normal((200, 1))
    found = fit_covariance(residual, jacobian, np.ones(1), np.ones(1), lags=10)
    deviations = found.deviations(np.eye(3))
    assert deviations[1] == pytest.approx(1e6)
    assert deviations[[0, 2]].max() < 1.0
