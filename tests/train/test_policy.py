"""The policy of a run directory."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from skewmi.errors import LayoutMismatchError
from skewmi.policy_io import Ball
from skewmi.train.checkpoint import read_checkpoint
from skewmi.train.log import read_metrics
from skewmi.train.policy import load_policy
from skewmi.train.registry import make_learner
from skewmi.train.run import run_train
from skewmi.train.state import split


@pytest.mark.parametrize("average", [0.0, 0.9])
def test_policy_of_a_run(tmp_path, make_corridor, corridor_config, average: float) -> None:
    env = make_corridor()
    learner = replace(corridor_config.learner, actor_average=average)
    corridor_config = replace(corridor_config, learner=learner)
    run_train(corridor_config, env, tmp_path, progress=False)
    policy = load_policy(tmp_path)
    assert policy.layout == env.layout
    state = read_checkpoint(tmp_path).state
    np.testing.assert_array_equal(policy.goal, state["evaluation_goal"])
    observation = np.random.default_rng(0).uniform(0, 4, size=(3, 7, 3))
    action = policy.act(observation)
    assert action.shape == (3, 7, 2)
    assert np.abs(action).max() <= 1.0
    np.testing.assert_allclose(policy.act(observation[1, 2]), action[1, 2], atol=1e-6)
    # The very action that training's evaluation episodes take.
    learner = make_learner(corridor_config.learner, env.layout, 2, 0, "cpu")
    learner.load_state_dict(state["learner"])
    flat = observation.reshape(-1, 3)
    goals = np.broadcast_to(policy.goal, (len(flat), 2))
    expected = learner.act(flat, goals, None, evaluation=len(flat)).action
    np.testing.assert_allclose(action.reshape(-1, 2), expected, atol=1e-6)
    with pytest.raises(LayoutMismatchError, match="2 fields"):
        policy.act(np.zeros((4, 2)))
    assert json.loads(json.dumps(policy.metadata))["task"] == "corridor"


def test_best_checkpoint_is_the_best_evaluated(tmp_path, make_corridor, corridor_config) -> None:
    # Every state is rewarded where x < 4, so that evaluation succeeds at once.
    env = make_corridor()
    everywhere = replace(env.layout, reward_region=(Ball(("x",), (2.0,), 2.0),))
    env.layout = everywhere
    rollout = replace(corridor_config.rollout, random_steps=0)
    corridor_config = replace(corridor_config, rollout=rollout)
    result = run_train(corridor_config, env, tmp_path, progress=False)
    assert result.evaluation_fraction == 1.0
    # One of five is evaluated in the first iteration, and two once that one ended in the reward:
    # eleven of the first thirty trajectories.
    assert (result.converged_at, result.converged_at_paper) == (None, 30)
    best, latest = read_checkpoint(tmp_path, "best"), read_checkpoint(tmp_path)
    assert best.path.name.startswith("best-")
    assert best.state["best_score"] == [1.0, 40.0]
    assert best.state["step"] <= latest.state["step"]
    assert load_policy(tmp_path, "best").metadata["evaluation_fraction"] == 1.0
    longer = replace(corridor_config, total_steps=8000, stop_on_convergence=True)
    result = run_train(longer, env, tmp_path, resume=True, progress=False)
    assert result.stopped_by == "convergence"
    assert result.converged_at_paper == 30
    assert result.converged_at == 5 * 26
    table = read_metrics(tmp_path)
    for name, at in (("_paper", 30), ("", 130)):
        column = np.array(table[f"trajectories_to_convergence{name}"])
        met = np.array(table["trajectories"]) >= at
        assert (column[met] == at).all()
        assert np.isnan(column[~met]).all()


def test_best_checkpoint_holds_what_was_evaluated(tmp_path, make_corridor, corridor_config) -> None:
    """Networks and goal as they were for these episodes, not as what they taught left them."""

    def run(name: str, *steps: int) -> Path:
        for total in steps:
            env = make_corridor()
            env.layout = replace(env.layout, reward_region=(Ball(("x",), (2.0,), 2.0),))
            config = replace(corridor_config, total_steps=total)
            run_train(config, env, tmp_path / name, resume=True, progress=False)
        return tmp_path / name

    # The first iteration is random, the second the first that is evaluated.
    whole, parts = run("whole", 400), run("parts", 200, 400)
    before, after = (read_checkpoint(folder).state for folder in (run("half", 200), whole))
    for folder in (whole, parts):
        best = read_checkpoint(folder, "best")
        assert best.path.name == "best-0000000400"
        assert best.state["updates"] == before["updates"] < after["updates"]
        ours, theirs = (split(s["learner"])[0] for s in (best.state, before))
        assert all(torch.equal(ours[k], theirs[k]) for k in ours if k.startswith("actor/"))
        assert torch.equal(best.state["evaluation_goal"], before["evaluation_goal"])
        assert not torch.equal(best.state["evaluation_goal"], after["evaluation_goal"])
        assert best.state["evaluation_fraction"] == 1.0
    one, other = (split(read_checkpoint(folder, "best").state) for folder in (whole, parts))
    assert one[1] == other[1]
    assert all(torch.equal(one[0][name], other[0][name]) for name in one[0])
