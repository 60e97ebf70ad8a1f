"""Hindsight against brute force, on episodes made up at random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from skewmi.train.exploration.protocol import total_reward
from skewmi.train.exploration.scale import Scale
from skewmi.train.exploration.skew_explore import SkewExplore, SkewExploreConfig
from skewmi.train.inputs import InputNormalizer
from skewmi.train.replay import Replay
from skewmi.train.sac.hindsight import make_batch, n_step_return, relabel


def test_n_step_return_by_hand() -> None:
    rewards = np.array([[1.0, 2.0, 4.0], [1.0, 2.0, 4.0], [1.0, 2.0, 4.0]])
    got = n_step_return(rewards, np.array([3, 2, 1]), 0.5)
    np.testing.assert_allclose(got, [1 + 1 + 1, 1 + 1, 1])


@pytest.mark.parametrize("bootstrap", [True, False])
def test_relabelled_batch_is_brute_force(filled, layout, bootstrap: bool) -> None:
    history, episodes, term = filled
    rng = np.random.default_rng(2)
    config = SkewExploreConfig(goal_clip=-9.0)
    exploration = SkewExplore(config, layout, rng)
    scale = Scale(np.array([1.0, 2.0]), np.array([0.5, 0.8]), np.ones(2))
    exploration.skewed.scale = scale
    drawn = history.draw(200, 3, 0.0, rng)
    goals = rng.uniform(0, 4, size=(200, 2))
    rewards = total_reward(
        exploration, drawn.states, goals[:, None], drawn.trajectory_term, drawn.rewards
    )
    batch = make_batch(
        drawn,
        goals,
        rewards,
        InputNormalizer(layout, 2, normalize=True),
        discount=0.99,
        bootstrap_at_timeout=bootstrap,
        device=torch.device("cpu"),
    )
    c, gamma = config, 0.99
    normal = multivariate_normal(np.zeros(2), c.sigma**2 * np.eye(2))
    steps = layout.episode_steps
    for i in range(200):
        e, t = drawn.episode[i], drawn.step[i]
        expected, k = 0.0, 0
        while k < 3 and t + k < steps:
            state = episodes.observations[e, t + k + 1, :2]
            log_p_z = max(normal.logpdf((state - goals[i]) / scale.unit), -9.0)
            intrinsic = c.intrinsic * (log_p_z - term[e, t + k])
            expected += gamma**k * (intrinsic + c.extrinsic * episodes.rewards[e, t + k])
            k += 1
        assert float(batch.returns[i]) == pytest.approx(expected, abs=1e-5)
        ends = t + k == steps and not bootstrap
        assert float(batch.discounts[i]) == pytest.approx(0.0 if ends else gamma**k)


def test_hindsight_mix(filled, layout) -> None:
    history, episodes, _ = filled
    rng = np.random.default_rng(3)
    drawn = history.draw(4000, 3, 0.0, rng)
    proposals = np.array([[100.0, 100.0], [200.0, 200.0]])
    goals = relabel(drawn, history, proposals, 0.5, 0.3, rng)
    proposed = goals[:, 0] >= 100.0
    own = (goals == drawn.goal).all(1)
    assert proposed.mean() == pytest.approx(0.3, abs=0.03)
    assert own.mean() == pytest.approx(0.2, abs=0.03)
    for i in np.flatnonzero(~proposed & ~own)[:300]:
        later = episodes.observations[drawn.episode[i], drawn.step[i] + 1 :, :2]
        assert np.isclose(later, goals[i], rtol=1e-6).all(1).any()


def test_without_goals_nothing_is_relabelled(layout, make_episodes) -> None:
    rng = np.random.default_rng(4)
    history = Replay(layout, 480, 0)
    episodes = make_episodes(layout, 4, rng)
    episodes = replace(episodes, goals=np.zeros((4, layout.episode_steps, 0)))
    history.add(episodes, np.zeros_like(episodes.rewards))
    drawn = history.draw(30, 3, 0.0, rng)
    before = rng.bit_generator.state
    assert relabel(drawn, history, np.zeros((0, 0)), 0.5, 0.3, rng).shape == (30, 0)
    assert rng.bit_generator.state == before
