"""Proximal policy optimization in the runner: it remembers, resumes to the bit, and is deployed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from recall_task import ASKED, Nothing, NothingConfig, Recall
from train_runs import resumes_alike

from skewmi.deploy.policy import OnnxPolicy
from skewmi.errors import LayoutMismatchError
from skewmi.evaluation.rollout import run_episodes
from skewmi.export.onnx_export import TOLERANCE, export_policy
from skewmi.train.checkpoint import read_checkpoint
from skewmi.train.config import RolloutConfig, TrainConfig
from skewmi.train.exploration.protocol import total_reward
from skewmi.train.learner import Rollout
from skewmi.train.log import read_metrics
from skewmi.train.policy import load_policy
from skewmi.train.ppo.advantages import advantages
from skewmi.train.ppo.config import PpoConfig
from skewmi.train.ppo.learner import PpoLearner
from skewmi.train.registry import EXPLORATIONS, Entry
from skewmi.train.rollout import collect
from skewmi.train.run import run_train
from skewmi.train.runner import Runner

ITERATION = 5 * 40
"""Environment steps of five episodes in the corridor."""


@pytest.fixture
def ppo_config(corridor_config: TrainConfig) -> TrainConfig:
    """Updates after every third iteration: four of five episodes are its own."""
    rollout = replace(corridor_config.rollout, random_steps=0, noise_probability=0.0)
    learner = PpoConfig(
        memory=8, heads=(8,), steps_per_update=3 * 4 * 40, epochs=2, minibatches=3,
        sequence_length=15, learning_rate=3e-3,
    )  # fmt: skip
    return replace(corridor_config, learner=learner, rollout=rollout, total_steps=7 * ITERATION)


def rolled_out(runner: Runner) -> Rollout:
    return collect(
        runner.env,
        runner.learner,
        runner.exploration,
        runner.generator,
        config=RolloutConfig(noise_probability=0.0, noise_correlation=0.0),
        evaluation=1,
    )


def recall_config(memory: int) -> TrainConfig:
    return TrainConfig(
        task="recall",
        total_steps=10 * 64 * 8,
        learner=PpoConfig(
            memory=memory, heads=(16,), learning_rate=1e-2, steps_per_update=64 * 8,
            epochs=4, minibatches=4, sequence_length=None, initial_log_std=-0.5,
        ),
        exploration=NothingConfig(),
        rollout=RolloutConfig(
            num_envs=64, evaluation_envs=0, random_steps=0, noise_probability=0.0
        ),
    )  # fmt: skip


@pytest.fixture
def without_exploration(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(EXPLORATIONS, "nothing", Entry(NothingConfig, Nothing))


def answers(runner: Runner, episodes: int = 200) -> float:
    """Share of right answers of the deterministic policy."""
    env = Recall(episodes)
    observation, hidden, paid = env.reset(seed=5), None, 0.0
    for _ in range(env.layout.episode_steps):
        decision = runner.learner.act(observation, np.zeros((episodes, 0)), hidden, episodes)
        result, hidden = env.step(decision.action), decision.hidden
        observation = result.observation
        paid += result.reward.mean()
    return paid / ASKED


def test_memory_solves_what_nobody_without_one_can(without_exploration: None) -> None:
    share = {}
    for memory in (16, 0):
        runner = Runner(recall_config(memory), Recall(64))
        for _ in range(10):
            runner.iterate()
        share[memory] = answers(runner)
    assert share[16] > 0.95, share
    # Without a memory the answer cannot depend on the cue.
    assert 0.35 < share[0] < 0.65, share


@pytest.mark.parametrize("before", [3, 5])  # with nothing waiting, and with two iterations
def test_resumes_bit_identically(tmp_path, make_corridor, ppo_config, before: int) -> None:
    whole = resumes_alike(ppo_config, make_corridor, tmp_path, before * ITERATION)
    table = read_metrics(whole)
    assert table["updates"] == [0.0, 0.0, 6.0, 6.0, 6.0, 12.0, 12.0]
    assert np.isfinite(table["policy_loss"]).tolist() == [n in (2, 5) for n in range(7)]
    state = read_checkpoint(whole).state["learner"]
    assert list(state["waiting"]) == ["0"]
    assert state["waiting"]["0"]["h"].shape == (4, 40, 8)
    assert state["waiting"]["0"]["h"].any()


def test_memory_is_each_episodes_own_and_starts_empty(make_corridor, ppo_config) -> None:
    runner = Runner(ppo_config, make_corridor())
    learner = runner.learner
    assert isinstance(learner, PpoLearner)
    for _ in range(2):
        rollout = rolled_out(runner)
        h, c = rollout.notes["h"], rollout.notes["c"]
        assert h.shape == c.shape == (5, 40, 8)
        assert not h[:, 0].any()
        assert not c[:, 0].any()
        episodes = rollout.episodes
        x = learner.inputs(episodes.observations[:, :-1], episodes.goals)
        for row in range(5):
            alone = learner.ppo.network.empty(1)
            for t in range(40):
                np.testing.assert_allclose(h[row, t], alone[0][0].detach(), atol=1e-6)
                _, _, alone = learner.ppo.network(x[row : row + 1, t : t + 1], alone)
    assert not np.allclose(h[0, 5:], h[1, 5:])


def test_actions_are_clipped_samples_and_means(make_corridor, ppo_config) -> None:
    runner = Runner(ppo_config, make_corridor())
    rollout = rolled_out(runner)
    drawn, taken = rollout.notes["drawn"], rollout.episodes.actions
    np.testing.assert_array_equal(taken, np.clip(drawn.astype(float), -1.0, 1.0))
    assert (np.abs(drawn) > 1.0).any()  # a deviation of 1 leaves the range often
    # The evaluation episode has the mean: no noise from step to step.
    jumps = np.abs(np.diff(drawn, axis=1)).mean((1, 2))
    assert jumps[0] < 0.1 * jumps[1:].min()


@pytest.mark.parametrize("bootstrap", [True, False])
def test_batch_is_what_was_collected(make_corridor, ppo_config, bootstrap: bool) -> None:
    learner_config = replace(ppo_config.learner, bootstrap_at_timeout=bootstrap)
    runner = Runner(replace(ppo_config, learner=learner_config), make_corridor())
    learner = runner.learner
    assert isinstance(learner, PpoLearner)
    rollout = rolled_out(runner)
    episodes = rollout.episodes
    term = runner.exploration.observe(episodes)
    learner.observe(rollout, term)
    (collected,) = learner.waiting
    rewards = learner._rewards(collected, runner.exploration)
    states = episodes.observations[1:, 1:, :2]
    np.testing.assert_allclose(
        rewards,
        total_reward(
            runner.exploration, states, episodes.goals[1:], term[1:], episodes.rewards[1:]
        ),
    )
    batch, _ = learner.sequences(collected, rewards)
    assert batch.inputs.shape == (4 * 3, 15, 5)  # 40 steps: 15, 15 and 10
    assert batch.real.sum(1).tolist() == [15, 15, 10] * 4
    # Values all along each episode, the state that was cut off included, in one go.
    goals = np.concatenate((episodes.goals, episodes.goals[:, -1:]), axis=1)[1:]
    x = learner.inputs(episodes.observations[1:], goals)
    values = learner.ppo.values(x, learner.ppo.network.empty(4)).double().numpy()
    ends = np.zeros((4, 40), dtype=bool)
    ends[:, -1] = True
    expected = advantages(
        rewards, values[:, :-1], values[:, 1:], ends & (not bootstrap), ends,
        discount=0.99, trace_decay=0.95,
    )  # fmt: skip

    def whole(part: torch.Tensor) -> np.ndarray:
        return part.reshape(4, 45, *part.shape[2:])[:, :40].double().numpy()

    np.testing.assert_allclose(whole(batch.advantages), expected, atol=1e-5)
    np.testing.assert_allclose(whole(batch.returns), expected + values[:, :-1], atol=1e-5)
    np.testing.assert_allclose(whole(batch.inputs), x[:, :40].numpy(), atol=1e-6)
    # Every sequence begins with the memory it had: the densities are those of the rollout.
    _, value, _ = learner.ppo.network(batch.inputs, batch.hidden)
    np.testing.assert_allclose(whole(value.detach()), values[:, :-1], atol=1e-5)
    told = learner.ppo.loss(batch)[1]
    assert float(told["divergence"]) < 1e-10


@pytest.mark.parametrize("scaled", [True, False])
def test_rewards_are_learned_from_in_their_unit(
    make_corridor, ppo_config, monkeypatch: pytest.MonkeyPatch, scaled: bool
) -> None:
    config = replace(ppo_config.learner, scale_rewards=scaled, steps_per_update=4 * 40)
    runner = Runner(replace(ppo_config, learner=config), make_corridor())
    learner, given = runner.learner, []
    sequences = learner.sequences

    def watched(collected, rewards):
        given.append((learner._rewards(collected, runner.exploration), rewards))
        return sequences(collected, rewards)

    monkeypatch.setattr(learner, "sequences", watched)
    for _ in range(2):
        metrics, _ = runner.iterate()
    rewards, used = given[-1]
    unit = metrics["return_deviation"] if scaled else 1.0
    np.testing.assert_allclose(used * unit, rewards)


def exported(policy, path: Path, observations: np.ndarray) -> OnnxPolicy:
    report = export_policy(policy, path, observations, metadata={"robot_model_hash": None})
    assert report.max_difference <= TOLERANCE
    return OnnxPolicy.load(path)


def test_exported_policy_is_torchs_over_whole_episodes(
    tmp_path, make_corridor: Callable, ppo_config
) -> None:
    run_train(ppo_config, make_corridor(), tmp_path / "run", progress=False)
    policy = load_policy(tmp_path / "run")
    assert policy.metadata["learner"] == "ppo"
    seen = run_episodes(policy, make_corridor(3), 3, seed=5)
    deployed = exported(policy, tmp_path / "policy.onnx", seen.observation)
    assert deployed.recurrent
    assert deployed.metadata["memory"]["sizes"] == {"h": 8, "c": 8}
    # Eight episodes in three rounds: both forget between them.
    ours, theirs = (run_episodes(p, make_corridor(3), 8, seed=6) for p in (policy, deployed))
    assert np.abs(ours.action).max() > 0.0
    np.testing.assert_allclose(theirs.action, ours.action, rtol=0.0, atol=TOLERANCE)
    np.testing.assert_allclose(theirs.final_observation, ours.final_observation, atol=1e-4)
    # One observation at a time, as on a robot; and it does remember.
    deployed.reset()
    alone = np.stack([deployed.act(step[0]) for step in seen.observation])
    np.testing.assert_allclose(alone, seen.action[:, 0], rtol=0.0, atol=TOLERANCE)
    again = deployed.act(seen.observation[0, 0])
    deployed.reset()
    first = deployed.act(seen.observation[0, 0])
    np.testing.assert_array_equal(first, alone[0])
    assert np.abs(again - first).max() > 1e-4
    with pytest.raises(LayoutMismatchError, match="1 episodes and got 3 observations; reset"):
        deployed.act(seen.observation[0])


def test_policy_without_memory_is_exported_as_one(tmp_path, make_corridor, ppo_config) -> None:
    config = replace(ppo_config, learner=replace(ppo_config.learner, memory=0))
    run_train(config, make_corridor(), tmp_path / "run", progress=False)
    policy = load_policy(tmp_path / "run")
    seen = run_episodes(policy, make_corridor(3), 3, seed=5)
    deployed = exported(policy, tmp_path / "policy.onnx", seen.observation)
    assert not deployed.recurrent
    assert "memory" not in deployed.metadata
    theirs = run_episodes(deployed, make_corridor(3), 3, seed=5)
    np.testing.assert_allclose(theirs.action, seen.action, rtol=0.0, atol=TOLERANCE)


def test_policy_is_the_evaluated_one(tmp_path, make_corridor, ppo_config) -> None:
    """The action that training's evaluation episodes take, normalized inputs or not."""
    for normalize in (True, False):
        learner_config = replace(ppo_config.learner, normalize_input=normalize)
        learner = Runner(replace(ppo_config, learner=learner_config), make_corridor()).learner
        goal = np.array([3.0, 1.0])
        module = learner.policy_module(goal)
        observations = np.random.default_rng(0).uniform(0, 4, size=(6, 5, 3))
        hidden, memory = None, (torch.zeros(5, 8), torch.zeros(5, 8))
        for observation in observations:
            decision = learner.act(observation, np.tile(goal, (5, 1)), hidden, evaluation=5)
            hidden = decision.hidden
            action, *memory = module(torch.as_tensor(observation).float(), *memory)
            np.testing.assert_allclose(action.detach(), decision.action, atol=1e-5)
