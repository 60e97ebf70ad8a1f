"""Both criteria of convergence: what they accept, and how soon they accept what they should not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skewmi.policy_io import Array
from skewmi.train.config import MetricsConfig
from skewmi.train.convergence import Convergence, different

STEPS = 40


def new(trajectories: int = 50) -> Convergence:
    m = MetricsConfig()
    return Convergence(m.convergence_fraction, m.convergence_tolerance, trajectories)


def rewards_of(shares: Array) -> Array:
    """Trajectories of which these shares of the last ten states are rewarded, and all before."""
    rewards = np.ones((len(shares), STEPS))
    rewards[:, -10:] = np.arange(10) < np.rint(10 * np.asarray(shares))[:, None]
    return rewards


class Feed:
    """Hands trajectories that differ to a criterion, one number after the other."""

    def __init__(self, convergence: Convergence) -> None:
        self.convergence, self.count = convergence, 0

    def __call__(self, *shares: float) -> None:
        n = len(shares)
        observations = np.arange(self.count, self.count + n, dtype=float)[:, None, None]
        self.count += n
        self.convergence.add(observations, rewards_of(np.array(shares)), self.count)


def test_the_published_criterion_wants_ten_alike() -> None:
    convergence = new()
    feed = Feed(convergence)
    for _ in range(9):
        feed(1.0)
        assert not convergence.published  # fewer than ten trajectories
    feed(0.9)
    # 99 of 100 states, and a standard deviation of exactly 3 %: not below.
    assert convergence.fraction == pytest.approx(0.99)
    assert convergence.published_at is None
    feed(*[1.0] * 9)
    assert convergence.published_at is None
    feed(1.0)
    assert convergence.published_at == 20
    feed(0.0)
    assert not convergence.published
    assert convergence.published_at == 20  # the first time is kept
    feed(*[0.9] * 10)
    assert convergence.published  # nine of ten states, in each
    feed(*[0.8] * 10)
    assert not convergence.published


def test_ours_wants_48_of_50() -> None:
    for failures, holds in ((0, True), (2, True), (3, False)):
        convergence = new()
        feed = Feed(convergence)
        feed(*[1.0] * 49)
        assert not convergence.converged  # fewer than fifty trajectories
        feed(*[0.0] * failures, *[1.0] * (50 - failures))
        assert convergence.converged is holds
        assert convergence.at == (99 if holds else None)
    feed(1.0)
    assert convergence.at == 100  # one failure has left the window


def test_ours_is_about_the_mean_as_well_as_its_deviation() -> None:
    for share, holds in ((0.8, False), (0.9, True)):  # no deviation at all
        convergence = new()
        Feed(convergence)(*[share] * 50)
        assert convergence.converged is holds


def test_the_same_trajectory_counts_once() -> None:
    observations = np.zeros((4, 6, 2))
    observations[1, 3, 0] = observations[3, 3, 0] = 1.0
    assert different(observations).tolist() == [0, 1]
    convergence = new()
    convergence.add(observations, np.ones((4, 5)), 4)
    assert list(convergence.shares) == [1.0, 1.0]
    # Nine copies of one success and one failure are no nine tenths.
    observations = np.zeros((10, 6, 2))
    observations[9] = 1.0
    rewards = np.ones((10, 5))
    rewards[9] = 0.0
    convergence = new()
    convergence.add(observations, rewards, 10)
    assert convergence.latest == convergence.fraction == 0.5


def first_times(p: float, *, runs: int, batches: int, batch: int, seed: int = 0) -> Array:
    """Trajectories after which the published criterion and ours first accepted policies that
    succeed in a trajectory with probability p, or infinity. Shape (runs, 2)."""
    generator = np.random.default_rng(seed)
    found = np.full((runs, 2), np.inf)
    for run in range(runs):
        convergence = new()
        feed = Feed(convergence)
        for shares in (generator.random((batches, batch)) < p).astype(float):
            feed(*shares)
        times = (convergence.published_at, convergence.at)
        found[run] = [np.inf if at is None else at for at in times]
    return found


@pytest.mark.parametrize(("batch", "runs"), [(1, 1), (10, 5)])
def test_a_policy_that_fails_in_three_of_ten_is_not_taken_for_done(batch: int, runs: int) -> None:
    """The bar: of policies with p = 0.7, at most 1 in 100 within 2,000 trajectories that count."""
    trajectories = 2_000
    found = first_times(0.7, runs=runs, batches=trajectories // batch, batch=batch)
    published, ours = found.T
    # 4.5e-6 per window of 50, so at most 0.9 % by the union bound; the seed is fixed.
    assert np.isinf(ours).all()
    assert np.isfinite(published).all()  # the published one has been met by all of them


def test_the_chance_of_a_window_keeps_the_bar() -> None:
    def at_least(k: int, n: int) -> float:
        return sum(math.comb(n, i) * 0.7**i * 0.3 ** (n - i) for i in range(k, n + 1))

    # By the union bound over 2,000 windows, however much they overlap.
    assert 2_000 * at_least(48, 50) < 0.01
    # What ours replaced took nine of ten: one window in seven.
    assert at_least(9, 10) == pytest.approx(0.149, abs=1e-3)


def test_ten_successes_in_a_row_prove_little() -> None:
    """How soon a policy with p = 0.7 has met the published criterion, exactly."""
    row = np.zeros(10)  # probability of so many successes since the last failure, and no ten yet
    row[0], met = 1.0, []
    for _ in range(500):
        done = 0.7 * row[-1]
        met.append((met[-1] if met else 0.0) + done)
        row = np.concatenate(([0.3 * row.sum()], 0.7 * row[:-1]))
    assert met[81] >= 0.5 > met[80]
    assert met[499] > 0.985


def test_a_policy_that_is_done_is_soon_known() -> None:
    found = first_times(0.99, runs=20, batches=20, batch=10)
    assert np.median(found[:, 0]) <= 20
    assert np.median(found[:, 1]) <= 60
    assert np.isfinite(found).all()


def test_state_continues_alike() -> None:
    one, other = new(), new()
    feed = Feed(one)
    feed(*[1.0] * 10, 0.3, 0.9)
    other.load_state_dict(one.state_dict())
    assert other.state_dict() == one.state_dict()
    assert (other.published_at, other.at, other.latest) == (one.published_at, None, one.latest)
    earlier = {name: one.state_dict()[name] for name in ("fractions", "returns")}
    third = new()
    third.load_state_dict(earlier)  # a checkpoint of an earlier version
    assert third.score == one.score
    assert third.at is None
