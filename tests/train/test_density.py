"""Densities against scipy and brute force; metrics against the published formulas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import gaussian_kde, multivariate_normal

from skewmi.train.density import (
    gaussian_log_density,
    kernel_log_density,
    trajectory_log_density,
)
from skewmi.train.metrics import CoverageMetrics, published_coverage, published_entropy
from skewmi.train.running_mean_std import RunningMeanStd


def brute_force(query: np.ndarray, points: np.ndarray, h: float) -> np.ndarray:
    normal = multivariate_normal(np.zeros(points.shape[1]), h**2 * np.eye(points.shape[1]))
    return np.log([np.mean(normal.pdf(x - points)) for x in query])


@pytest.mark.parametrize("dim", [1, 2, 6])
def test_gaussian_is_scipys(dim: int) -> None:
    rng = np.random.default_rng(dim)
    x, z = rng.normal(size=(7, dim)), rng.normal(size=dim)
    expected = multivariate_normal(z, 0.7**2 * np.eye(dim)).logpdf(x)
    np.testing.assert_allclose(gaussian_log_density(x, z, 0.7), expected, atol=1e-12)


def test_kernel_density_is_scipys() -> None:
    rng = np.random.default_rng(0)
    points, query = rng.normal(size=(2, 300)), rng.normal(size=(2, 50))
    h = 0.3
    # scipy scales by the data's covariance; whitened data make that a plain bandwidth.
    points = np.linalg.solve(np.linalg.cholesky(np.cov(points)), points)
    expected = gaussian_kde(points, bw_method=h).logpdf(query)
    for single, tolerance in ((True, 1e-4), (False, 1e-10)):
        got = kernel_log_density(query.T, points.T, h, single=single)
        np.testing.assert_allclose(got, expected, atol=tolerance)


@settings(deadline=None)
@given(
    n=st.integers(1, 40),
    m=st.integers(1, 30),
    dim=st.integers(1, 6),
    h=st.floats(0.05, 3.0),
    seed=st.integers(0, 2**31),
)
def test_kernel_density_does_not_depend_on_chunks(
    n: int, m: int, dim: int, h: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    points, query = rng.normal(size=(n, dim)), rng.normal(size=(m, dim))
    whole = kernel_log_density(query, points, h, single=False)
    parts = kernel_log_density(query, points, h, single=False, chunk=7)
    np.testing.assert_allclose(parts, whole, atol=1e-9)


def test_kernel_density_far_away_does_not_underflow() -> None:
    points = np.zeros((10, 2))
    got = kernel_log_density(np.array([[100.0, 0.0]]), points, 0.5)
    expected = gaussian_log_density(np.array([[100.0, 0.0]]), np.zeros(2), 0.5)
    np.testing.assert_allclose(got, expected, rtol=1e-5)


def test_own_count_bounds_the_density_from_below() -> None:
    points = np.random.default_rng(1).normal(size=(99, 2))
    outlier = np.array([[50.0, 50.0]])
    at_zero = gaussian_log_density(np.zeros((1, 2)), np.zeros(2), 0.5)
    got = kernel_log_density(outlier, points, 0.5, self_count=1.0)
    np.testing.assert_allclose(got, at_zero - np.log(100.0), atol=1e-5)


def test_leave_one_out_is_brute_force() -> None:
    points = np.random.default_rng(2).normal(size=(30, 3))
    got = kernel_log_density(points, points, 0.6, leave_one_out=True, single=False, chunk=70)
    expected = [brute_force(points[i : i + 1], np.delete(points, i, 0), 0.6)[0] for i in range(30)]
    np.testing.assert_allclose(got, expected, atol=1e-10)


@pytest.mark.parametrize("causal", [True, False])
def test_trajectory_density_is_brute_force(causal: bool) -> None:
    rng = np.random.default_rng(3)
    states = rng.normal(size=(3, 25, 4)).cumsum(1)
    got = trajectory_log_density(states, 0.8, causal=causal)
    for episode in range(3):
        for t in range(25):
            seen = states[episode, : t + 1] if causal else states[episode]
            expected = brute_force(states[episode, t : t + 1], seen, 0.8)
            np.testing.assert_allclose(got[episode, t], expected[0], atol=1e-4)


def test_trajectory_density_looks_only_back() -> None:
    states = np.random.default_rng(4).normal(size=(2, 30, 3))
    changed = states.copy()
    changed[:, 20:] += 5.0
    # Changing the future changes the centring, so compare after putting the mean back.
    before = trajectory_log_density(states, 0.5)[:, :20]
    after = trajectory_log_density(changed, 0.5)[:, :20]
    np.testing.assert_allclose(before, after, atol=1e-4)


@settings(deadline=None)
@given(parts=st.lists(st.integers(1, 20), min_size=1, max_size=6), seed=st.integers(0, 2**31))
def test_running_mean_and_variance_are_those_of_everything(parts: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    chunks = [rng.normal(3.0, 2.0, size=(n, 2)) for n in parts]
    running = RunningMeanStd(2)
    for chunk in chunks:
        running.update(chunk)
    whole = np.concatenate(chunks)
    np.testing.assert_allclose(running.mean, whole.mean(0), atol=1e-9)
    np.testing.assert_allclose(running.variance, whole.var(0), atol=1e-9)


def test_published_entropy_of_a_uniform_density() -> None:
    # log(area) per point: the published figure is a sum over points without their area.
    log_density = np.full(500, -np.log(80.0))
    assert published_entropy(log_density) == pytest.approx(500 * np.log(80.0) / 80.0)
    assert published_entropy(np.array([-np.inf, -np.inf])) == 0.0


def test_published_coverage() -> None:
    assert published_coverage(np.array([0.0, np.inf]), 0.1) == pytest.approx(0.5)
    assert published_coverage(np.array([0.1]), 0.1) == pytest.approx(np.exp(-0.5))


def test_coverage_of_a_full_and_an_empty_space(make_corridor, corridor_config) -> None:
    env = make_corridor()
    coverage = CoverageMetrics(env.layout, corridor_config.task_metrics, corridor_config.metrics)
    coverage.set_reachable(env, env.reset()[0, :2])
    assert coverage.coverage()["covered_cells"] == 0.0
    x, y = np.meshgrid(np.linspace(0, 4, 81), np.linspace(0, 4, 81))
    everywhere = np.stack((x.ravel(), y.ravel()), axis=1)
    # Visiting half of the space covers half of its reachable cells.
    half = everywhere[everywhere[:, 0] < 2.0]
    coverage.add(half[env.reachable(half)])
    reachable = coverage.reachable.sum()
    assert coverage.coverage()["covered_cells"] == pytest.approx(0.5, abs=0.08)
    coverage.add(everywhere[env.reachable(everywhere)])
    assert coverage.coverage()["covered_cells"] == 1.0
    assert reachable == 100 - 2 * 7  # the wall is two columns of seven cells
