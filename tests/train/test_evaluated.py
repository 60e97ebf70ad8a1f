"""Which trajectories tell whether a task is learned, as a run goes on."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from train_runs import resumes_alike

from skewmi.errors import ConfigurationError
from skewmi.policy_io import Ball
from skewmi.train import runner as runners
from skewmi.train.config import RolloutConfig
from skewmi.train.runner import Runner

ITERATION = 10 * 40


@pytest.fixture
def config(corridor_config):
    rollout = replace(corridor_config.rollout, num_envs=10, evaluation_envs=2, random_steps=0)
    return replace(corridor_config, rollout=rollout)


@pytest.fixture
def make_paid(make_corridor):
    """The corridor, rewarded wherever one stands but for the far side."""

    def make():
        env = make_corridor(10)
        env.layout = replace(env.layout, reward_region=(Ball(("x",), (0.0,), 1.5),))
        return env

    return make


def evaluated(runner: Runner, monkeypatch: pytest.MonkeyPatch, shares: list[float]) -> list[int]:
    """How many copies each iteration evaluated if those before it ended in the reward so."""
    counts, collect = [], runners.collect

    def watched(*args, **options):
        counts.append(options["evaluation"])
        return collect(*args, **options)

    monkeypatch.setattr(runners, "collect", watched)
    for share in shares:
        runner.convergence.latest = share
        runner.iterate()
    return counts


def test_more_copies_are_evaluated_while_they_end_in_the_reward(
    config, make_paid, monkeypatch: pytest.MonkeyPatch
) -> None:
    runner = Runner(config, make_paid())
    assert evaluated(runner, monkeypatch, [0.0, 0.89, 0.9, 1.0, 0.5]) == [2, 2, 4, 4, 2]


@pytest.mark.parametrize(
    ("begin", "counts"), [(1.0, [2, 2, 2, 4, 2]), (0.5, [2, 2, 4, 4, 4]), (0.0, [4] * 5)]
)
def test_more_copies_are_evaluated_once_exploration_reaches_the_reward(
    config, make_paid, monkeypatch: pytest.MonkeyPatch, begin: float, counts: list[int]
) -> None:
    runner = Runner(
        replace(config, rollout=replace(config.rollout, evaluation_from=begin)), make_paid()
    )
    seen = []
    for ended, rewarded in ((0.0, 0.0), (0.0, 0.4), (0.0, 0.5), (1.0, 0.0), (0.5, 1.0)):
        runner.rewarded_share = rewarded
        seen += evaluated(runner, monkeypatch, [ended])
    assert seen == counts


def test_the_share_of_rewarded_episodes_is_that_of_the_latest_iteration(config, make_paid) -> None:
    runner = Runner(config, make_paid())
    for _ in range(3):
        metrics, _ = runner.iterate()
        slots = np.arange(runner.episodes - 10, runner.episodes) % runner.history.capacity
        latest = runner.history.rewarded[slots]
        assert metrics["rewarded_fraction"] == runner.rewarded_share == latest.mean()


@pytest.mark.parametrize(("envs", "share", "most"), [(0, 0.4, 0), (2, 0.0, 2), (3, 0.25, 3)])
def test_how_many_at_most(config, make_paid, monkeypatch, envs, share, most) -> None:
    rollout = replace(config.rollout, evaluation_envs=envs, evaluation_share=share)
    runner = Runner(replace(config, rollout=rollout), make_paid())
    assert evaluated(runner, monkeypatch, [0.0, 1.0]) == [envs, most]
    # Without copies that are evaluated, all trajectories count.
    assert len(runner.convergence.shares) == (envs + most or 20)


@pytest.mark.parametrize(("envs", "counted"), [(2, [0, 0, 2]), (0, [10, 20, 30])])
def test_random_actions_are_no_evaluation(config, make_paid, envs: int, counted: list[int]) -> None:
    """They end in the reward in this corridor, and it is not what the run has learned."""
    rollout = replace(config.rollout, evaluation_envs=envs, random_steps=2 * ITERATION)
    runner = Runner(replace(config, rollout=rollout), make_paid())
    seen, improved = [], []
    for iteration in range(3):
        metrics, _ = runner.iterate(partial(improved.append, iteration))
        assert metrics["rewarded_fraction"] > 0.5
        assert (metrics["evaluation_fraction"] > 0.0) == (seen == [0, 0] or envs == 0)
        seen.append(len(runner.convergence.shares))
    assert seen == counted
    assert improved[0] == (2 if envs else 0)


def test_evaluated_copies_of_one_policy_differ(config, make_paid) -> None:
    """Even where every episode begins alike, they aim at states that differ."""
    env = make_paid()
    reset = env.reset

    def alike(seed=None):
        reset(seed)
        env.position[:] = 0.5
        return env._observe()

    env.reset = alike
    runner = Runner(replace(config, total_steps=5 * ITERATION), env)
    for _ in range(5):
        runner.iterate()
    assert len(runner.convergence.shares) >= 5 * 2 - 1  # the first have one goal: no reward yet


@pytest.mark.parametrize("begin", [1.0, 0.5])
def test_a_run_that_evaluates_more_resumes_alike(tmp_path, config, make_paid, begin) -> None:
    rollout = replace(config.rollout, evaluation_from=begin)
    whole = replace(config, total_steps=4 * ITERATION, rollout=rollout)
    resumes_alike(whole, make_paid, tmp_path, 2 * ITERATION)


@pytest.mark.parametrize("share", [-0.1, 1.1, 1.0, np.nan])
def test_shares_that_mean_nothing_are_refused(share: float) -> None:
    with pytest.raises(ConfigurationError, match="evaluation_share"):
        RolloutConfig(evaluation_share=share)
    if share != 1.0:
        with pytest.raises(ConfigurationError, match="evaluation_from"):
            RolloutConfig(evaluation_from=share)
