"""The unit of rewards."""

from __future__ import annotations

import numpy as np
import pytest

from skewmi.train.return_scale import ReturnScale, discounted_sums


def test_discounted_sums_are_what_was_paid_so_far() -> None:
    rewards = np.random.default_rng(0).normal(size=(3, 7))
    got = discounted_sums(rewards, 0.5)
    for t in range(7):
        expected = sum(0.5 ** (t - k) * rewards[:, k] for k in range(t + 1))
        np.testing.assert_allclose(got[:, t], expected)


def test_deviation_is_that_of_all_sums_seen() -> None:
    rng = np.random.default_rng(1)
    scale, seen = ReturnScale(0.9), []
    assert scale.deviation == 1.0
    for size in (0.1, 30.0, 3.0):
        rewards = size * rng.normal(1.0, 1.0, size=(4, 20))
        scale.update(rewards)
        seen.append(discounted_sums(rewards, 0.9))
        assert scale.deviation == pytest.approx(np.concatenate(seen).std())
    other = ReturnScale(0.9)
    other.load_state_dict(scale.state_dict())
    assert other.deviation == scale.deviation


def test_rewards_that_never_change_stay_as_they_are() -> None:
    scale = ReturnScale(0.0)
    scale.update(np.full((3, 8), 0.25))
    assert scale.deviation == 1.0
