"""A run that begins with another one's networks and episodes is a run of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from train_runs import assert_same_checkpoint, assert_same_table

from skewmi.errors import ConfigurationError
from skewmi.policy_io import Ball
from skewmi.train.checkpoint import read_checkpoint
from skewmi.train.history import visited_states
from skewmi.train.ppo.config import PpoConfig
from skewmi.train.run import run_train
from skewmi.train.runner import Runner

ITERATION = 5 * 40
EPISODES = 10
"""Of the origin."""


@pytest.fixture(params=["sac", "ppo"])
def config(request: pytest.FixtureRequest, corridor_config):
    rollout = replace(corridor_config.rollout, random_steps=0, noise_probability=0.0)
    if request.param == "ppo":
        learner = PpoConfig(
            memory=8, heads=(8,), steps_per_update=ITERATION, epochs=1, minibatches=2
        )
        corridor_config = replace(corridor_config, learner=learner)
    return replace(corridor_config, rollout=rollout, total_steps=EPISODES * 40)


@pytest.fixture
def make_alike(make_corridor):
    """The corridor, in which every episode begins at the same point: nothing of it is random."""

    def make():
        env = make_corridor()
        reset = env.reset

        def alike(seed=None):
            reset(seed)
            env.position[:] = 0.5
            return env._observe()

        env.reset = alike
        return env

    return make


def test_the_seed_decides_what_is_random_from_there_on(tmp_path, make_alike, config) -> None:
    origin = tmp_path / "origin"
    run_train(config, make_alike(), origin, progress=False)
    longer = replace(config, total_steps=2 * config.total_steps)

    def begun(name: str, seed: int, *steps: int) -> Path:
        for total in steps or (longer.total_steps,):
            run_train(
                replace(longer, seed=seed, total_steps=total), make_alike(), tmp_path / name,
                resume=True, start_from=origin, progress=False,
            )  # fmt: skip
        return tmp_path / name

    folders = [begun("one", 1), begun("two", 2), begun("again", 1)]
    one, two, again = (visited_states(folder)[0] for folder in folders)
    np.testing.assert_array_equal(one[:EPISODES], two[:EPISODES])
    # The first one after the origin's is evaluated, with the origin's policy and goal.
    np.testing.assert_array_equal(one[EPISODES], two[EPISODES])
    assert (one[EPISODES + 1 :] != two[EPISODES + 1 :]).any(axis=(1, 2)).all()
    np.testing.assert_array_equal(one, again)
    parts = begun("parts", 1, 3 * config.total_steps // 2, longer.total_steps)
    assert_same_table(folders[0], parts)
    assert_same_checkpoint(folders[0], parts, EPISODES * 2)


def test_the_origins_seed_does_not_repeat_its_beginning(tmp_path, make_alike, config) -> None:
    run_train(config, make_alike(), tmp_path, progress=False)
    checkpoint = read_checkpoint(tmp_path)
    fresh, runner, resumed = (Runner(config, make_alike()) for _ in range(3))
    runner.begin_with(checkpoint)
    resumed.load(checkpoint)
    states = [r.generator.bit_generator.state for r in (fresh, runner, resumed)]
    streams = [r.learner.state_dict()["generator"] for r in (fresh, runner, resumed)]
    for one, other in ((0, 1), (1, 2)):
        assert states[one] != states[other]
        assert not torch.equal(streams[one], streams[other])
    assert states[2] == checkpoint.state["generator"]
    assert torch.equal(streams[2], checkpoint.state["learner"]["generator"])


@pytest.mark.parametrize("met", [True, False])
def test_unrewarded_only_from_a_run_that_met_no_reward(
    tmp_path, make_corridor, corridor_config, met: bool
) -> None:
    center = 2.0 if met else 30.0
    env = make_corridor()
    env.layout = replace(env.layout, reward_region=(Ball(("x",), (center,), 2.0),))
    origin, run_dir = tmp_path / "origin", tmp_path / "run"
    config = replace(corridor_config, total_steps=2 * ITERATION)
    run_train(config, env, origin, progress=False)
    assert read_checkpoint(origin).state["rewarded_episodes"] == (EPISODES if met else 0)
    explore = replace(config, rewarded=False, total_steps=3 * ITERATION)
    if not met:
        run_train(explore, env, run_dir, start_from=origin, progress=False)
        return
    with pytest.raises(ConfigurationError, match=r"met the reward in 10 episodes.*--unrewarded"):
        run_train(explore, env, run_dir, start_from=origin, progress=False)
    assert not run_dir.exists()
