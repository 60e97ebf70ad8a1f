"""Methods that the package does not bring, in its own runner: what the seams leave room for."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tiny_methods import CountBonus, CountBonusConfig, Reinforce, ReinforceConfig
from train_runs import resumes_alike

import skewmi.train.runner
from skewmi.deploy.policy import OnnxPolicy
from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.export.onnx_export import TOLERANCE, export_policy
from skewmi.train.checkpoint import read_checkpoint, read_run_header
from skewmi.train.config import RolloutConfig, TrainConfig
from skewmi.train.log import read_metrics
from skewmi.train.policy import load_policy
from skewmi.train.registry import EXPLORATIONS, LEARNERS, Entry, default_config
from skewmi.train.rollout import collect
from skewmi.train.run import run_train
from skewmi.train.runner import Runner

ITERATION = 5 * 40
"""Environment steps of five episodes."""


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LEARNERS, "reinforce", Entry(ReinforceConfig, Reinforce))
    monkeypatch.setitem(EXPLORATIONS, "count-bonus", Entry(CountBonusConfig, CountBonus))


@pytest.fixture
def on_policy(corridor_config: TrainConfig) -> TrainConfig:
    """Updates after every third iteration: four of five episodes are its own."""
    rollout = replace(corridor_config.rollout, random_steps=0, noise_probability=0.0)
    learner = ReinforceConfig(steps_per_update=3 * 4 * 40)
    return replace(corridor_config, learner=learner, rollout=rollout, total_steps=7 * ITERATION)


def test_only_registry_and_presets_name_a_method() -> None:
    package = Path(skewmi.train.runner.__file__).parent
    explorations = ("skew_explore", "return_then_explore", "skew_fit", "rnd")
    methods = (
        "skewmi.train.sac",
        "skewmi.train.ppo",
        *(f"skewmi.train.exploration.{name}" for name in explorations),
    )
    for path in package.rglob("*.py"):
        place = path.relative_to(package)
        own = place.parts[0] in ("sac", "ppo", "presets") or path.stem in explorations
        if own or path.name == "registry.py":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            imported = node.module if isinstance(node, ast.ImportFrom) else None
            assert not (imported or "").startswith(methods), f"{place} imports {imported}"


@pytest.mark.parametrize("before", [3, 5])  # with nothing pending, and with two iterations
def test_recurrent_on_policy_learner_resumes_bit_identically(
    tmp_path, make_corridor, on_policy, before: int
) -> None:
    whole = resumes_alike(on_policy, make_corridor, tmp_path, before * ITERATION)
    table = read_metrics(whole)
    assert table["updates"] == [0.0, 0.0, 1.0, 1.0, 1.0, 2.0, 2.0]
    learned = np.isfinite(table["ratio_error"])
    assert learned.tolist() == [False, False, True, False, False, True, False]
    # The recorded densities are those of the stored hidden states: nothing came between.
    assert np.array(table["ratio_error"])[learned].max() < 1e-5
    state = read_checkpoint(whole).state["learner"]
    assert list(state["pending"]) == ["0"]
    assert state["pending"]["0"]["h"].shape == (4, 40, 8)


def test_hidden_state_is_each_episodes_own(make_corridor, on_policy) -> None:
    runner = Runner(on_policy, make_corridor())
    learner = runner.learner
    for _ in range(2):
        rollout = collect(
            runner.env,
            learner,
            runner.exploration,
            runner.generator,
            config=RolloutConfig(noise_probability=0.0, noise_correlation=0.0),
            evaluation=1,
        )
        h, c = rollout.notes["h"], rollout.notes["c"]
        assert h.shape == c.shape == (5, 40, 8)
        assert not h[:, 0].any()
        # Each episode alone, from nothing: the same memory at every step.
        episodes = rollout.episodes
        x = learner.inputs(episodes.observations[:, :-1], episodes.goals)
        for row in range(5):
            hidden = tuple(torch.zeros(1, 8) for _ in range(2))
            for t in range(40):
                np.testing.assert_allclose(h[row, t], hidden[0][0].detach(), atol=1e-6)
                _, *hidden = learner.network(x[row : row + 1, t], *hidden)
    assert not np.allclose(h[0, 5:], h[1, 5:])


def test_recurrent_policy_is_exported_and_deployed(tmp_path, make_corridor, on_policy) -> None:
    run_train(on_policy, make_corridor(), tmp_path / "run", progress=False)
    policy = load_policy(tmp_path / "run")
    assert policy.metadata["learner"] == "reinforce"
    env = make_corridor(3)

    def episode(actor) -> tuple[np.ndarray, np.ndarray]:
        observation, seen, taken = env.reset(seed=5), [], []
        actor.reset()
        for _ in range(env.layout.episode_steps):
            seen.append(observation)
            taken.append(actor.act(observation))
            observation = env.step(taken[-1]).observation
        return np.stack(seen), np.stack(taken)

    seen, actions = episode(policy)
    metadata = {"robot_model_hash": None}
    report = export_policy(policy, tmp_path / "policy.onnx", seen, metadata=metadata)
    assert report.max_difference <= TOLERANCE
    deployed = OnnxPolicy.load(tmp_path / "policy.onnx")
    assert deployed.recurrent
    np.testing.assert_allclose(episode(deployed)[1], actions, atol=1e-5)
    np.testing.assert_array_equal(episode(policy)[1], actions)  # a reset forgets everything
    # It does remember: the same observation again is another action.
    policy.reset()
    assert not np.array_equal(policy.act(seen[0]), policy.act(seen[0]))


@pytest.mark.parametrize("change", [{"random_steps": 200}, {"noise_probability": 0.1}])
def test_on_policy_learner_refuses_actions_that_are_not_its_own(
    tmp_path, make_corridor, on_policy, change: dict
) -> None:
    config = replace(on_policy, rollout=replace(on_policy.rollout, **change))
    with pytest.raises(ConfigurationError, match=next(iter(change))):
        run_train(config, make_corridor(), tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("learner", ["sac", "reinforce"])
def test_exploration_without_goals(tmp_path, make_corridor, corridor_config, learner: str) -> None:
    config = replace(corridor_config, exploration=CountBonusConfig(), total_steps=4 * ITERATION)
    if learner == "reinforce":
        rollout = replace(config.rollout, random_steps=0, noise_probability=0.0)
        config = replace(config, learner=ReinforceConfig(), rollout=rollout)
    whole = resumes_alike(config, make_corridor, tmp_path, 2 * ITERATION)
    table = read_metrics(whole)
    assert table["updates"][-1] > 0
    assert table["cells"][-1] > 1
    policy = load_policy(whole)
    assert policy.goal.shape == (0,)
    assert policy.metadata["method"] == "count-bonus"
    assert np.abs(policy.act(np.zeros((2, 3)))).max() <= 1.0


def test_configuration_of_a_method_keeps_its_name(tmp_path, make_corridor, on_policy) -> None:
    config = replace(on_policy, exploration=CountBonusConfig(cell=0.25), total_steps=ITERATION)
    run_train(config, make_corridor(), tmp_path, progress=False)
    assert read_run_header(tmp_path)[0] == config


def test_method_without_a_name_is_refused(
    tmp_path, make_corridor, on_policy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(LEARNERS, "reinforce")
    with pytest.raises(ConfigurationError, match="ReinforceConfig belongs to no registered"):
        run_train(on_policy, make_corridor(), tmp_path / "run", progress=False)
    with pytest.raises(NotFoundError, match="no learner 'reinforce'; there are sac"):
        default_config(LEARNERS, "reinforce")
