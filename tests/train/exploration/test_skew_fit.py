"""Skew-Fit's reward, and that Skew-Explore's becomes it as sigma goes to 0."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from train_runs import resumes_alike

from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array
from skewmi.train.exploration.goals import SkewedGoalsConfig
from skewmi.train.exploration.scale import Scale
from skewmi.train.exploration.skew_explore import SkewExplore, SkewExploreConfig
from skewmi.train.exploration.skew_fit import SkewFit, SkewFitConfig
from skewmi.train.ppo.config import PpoConfig

SCALE = Scale(np.array([1.0, 2.0]), np.array([0.5, 0.8]), np.array([1.0, 3.0]))


def skew_fit(layout, **numbers) -> SkewFit:
    made = SkewFit(SkewFitConfig(**numbers), layout, np.random.default_rng(0))
    made.skewed.scale = SCALE
    return made


def skew_explore(layout, **numbers) -> SkewExplore:
    config = SkewExploreConfig(**{"goal_clip": None, "trajectory_clip": None} | numbers)
    made = SkewExplore(config, layout, np.random.default_rng(0))
    made.skewed.scale = SCALE
    return made


@pytest.mark.parametrize("distance", ["euclidean", "squared"])
@pytest.mark.parametrize("weighted", [True, False])
def test_reward_is_the_distance_in_density_units(layout, distance: str, weighted: bool) -> None:
    exploration = skew_fit(layout, intrinsic=0.3, distance=distance, weights_in_reward=weighted)
    rng = np.random.default_rng(1)
    states, goals = rng.uniform(0, 4, (7, 5, 2)), rng.uniform(0, 4, (7, 1, 2))
    got = exploration.intrinsic_reward(states, goals, rng.normal(size=(7, 5)))
    for i in range(7):
        for t in range(5):
            apart = (states[i, t] - goals[i, 0]) / SCALE.unit
            far = np.linalg.norm(apart * SCALE.weight if weighted else apart)
            expected = -0.3 * (far**2 if distance == "squared" else far)
            assert got[i, t] == pytest.approx(expected)
    at_goal = exploration.intrinsic_reward(goals, goals, np.zeros((7, 1)))
    np.testing.assert_array_equal(at_goal, 0.0)


def test_trajectory_does_not_matter(layout, make_episodes) -> None:
    episodes = make_episodes(layout, 4, np.random.default_rng(2))
    term = skew_fit(layout).observe(episodes)
    assert term.shape == episodes.rewards.shape
    assert not term.any()


def leftover(layout, sigma: float, states: Array, goals: Array) -> float:
    """Largest difference, between pairs of states, of 2 sigma^2 r_sigma / w and Skew-Fit's reward.

    Differences, because rewards that differ by a constant are the same to who is paid at every
    step of episodes of one length.
    """
    explore = skew_explore(layout, sigma=sigma, intrinsic=0.01)
    fit = skew_fit(layout, intrinsic=1.0, distance="squared")
    term = explore.trajectory_term(states)
    scaled = 2.0 * sigma**2 / 0.01 * explore.intrinsic_reward(states, goals, term)
    gap = scaled - fit.intrinsic_reward(states, goals, np.zeros(states.shape[:-1]))
    return float(gap.max() - gap.min())


def test_skew_explore_becomes_skew_fit_as_sigma_goes_to_zero(layout, make_episodes) -> None:
    states = make_episodes(layout, 6, np.random.default_rng(3)).observations[:, 1:, :2]
    goals = np.random.default_rng(4).uniform(0, 4, (6, 1, 2))
    sigmas = [0.8, 0.4, 0.2, 0.1, 0.01, 1e-4]
    left = [leftover(layout, sigma, states, goals) for sigma in sigmas]
    # What is left is 2 sigma^2 times the range of log p_tau: it falls with sigma squared.
    assert left[0] > 1.0
    steps = zip(pairwise(left), pairwise(sigmas), strict=True)
    for (one, other), (sigma, smaller) in steps:
        assert other / one == pytest.approx((smaller / sigma) ** 2, rel=1e-3, abs=1e-7)
    assert left[-1] < 1e-6


def test_small_sigma_ranks_trajectories_as_skew_fit_does(layout, make_episodes) -> None:
    """Which of 40 trajectories is worth how much: a large sigma prefers those that spread."""
    states = make_episodes(layout, 40, np.random.default_rng(5)).observations[:, 1:, :2]
    goal = np.array([1.0, 3.0])
    # Half of them stay near one place.
    states[:20] = states[:20, :1] + 0.05 * states[:20]
    fit = skew_fit(layout, distance="squared")
    wanted = fit.intrinsic_reward(states, goal, np.zeros(states.shape[:-1])).sum(1).argsort()
    orders = {}
    for sigma in (2.0, 1e-3):
        explore = skew_explore(layout, sigma=sigma)
        term = explore.trajectory_term(states)
        orders[sigma] = explore.intrinsic_reward(states, goal, term).sum(1).argsort()
    np.testing.assert_array_equal(orders[1e-3], wanted)
    assert not np.array_equal(orders[2.0], wanted)


@pytest.mark.parametrize("learner", ["sac", "ppo"])
def test_trains_and_resumes(tmp_path, make_corridor, corridor_config, learner: str) -> None:
    goals = {
        f.name: getattr(corridor_config.exploration, f.name) for f in fields(SkewedGoalsConfig)
    }
    config = replace(corridor_config, exploration=SkewFitConfig(**goals), total_steps=800)
    if learner == "ppo":
        rollout = replace(config.rollout, random_steps=0, noise_probability=0.0)
        small = PpoConfig(memory=8, heads=(8,), steps_per_update=160, epochs=2, minibatches=2)
        config = replace(config, rollout=rollout, learner=small)
    whole = resumes_alike(config, make_corridor, tmp_path, 400)
    assert (whole / "metrics.csv").exists()


def test_unknown_distance_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="euclidean, squared"):
        SkewFitConfig(distance="far")  # type: ignore[arg-type]
