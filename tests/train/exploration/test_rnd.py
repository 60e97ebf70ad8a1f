"""Random network distillation: its bonus falls where it was, and every use sees the same units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from train_runs import resumes_alike

from skewmi.errors import CheckpointError, ConfigurationError
from skewmi.train.exploration.rnd import Distillation, Rnd, RndConfig
from skewmi.train.log import read_metrics
from skewmi.train.policy import load_policy
from skewmi.train.ppo.config import PpoConfig
from skewmi.train.replay import Replay
from skewmi.train.return_scale import ReturnScale
from skewmi.train.run import run_train

SMALL = RndConfig(target=(16,), predictor=(16, 16), features=32, learning_rate=1e-3, batch_size=50)


def test_networks_are_the_publications() -> None:
    made = Distillation(RndConfig(), 5, seed=0)

    def sizes(net: torch.nn.Sequential) -> list[int]:
        return [layer.out_features for layer in net if isinstance(layer, torch.nn.Linear)]

    assert sizes(made.target) == [32, 64, 64, 1024]
    assert sizes(made.predictor) == [32, 64, 64, 128, 1024]
    trained = {id(p) for group in made.optimizer.param_groups for p in group["params"]}
    assert trained == {id(p) for p in made.predictor.parameters()}


def test_bonus_falls_where_it_was_and_stays_elsewhere() -> None:
    rng = np.random.default_rng(0)
    made = Distillation(SMALL, 2, seed=0)
    here, there = rng.normal(0.0, 0.3, (500, 2)), rng.normal(2.0, 0.3, (500, 2))
    made.normalization.update(np.concatenate((here, there)))
    before = made.errors(here).mean(), made.errors(there).mean()
    target = {name: value.clone() for name, value in made.target.state_dict().items()}
    for _ in range(3):
        loss = made.train(here, rng)
    after = made.errors(here).mean(), made.errors(there).mean()
    assert after[0] < 0.05 * before[0]
    assert after[1] > 5.0 * after[0]
    assert loss == pytest.approx(after[0], rel=0.5)
    assert all(torch.equal(value, target[name]) for name, value in made.target.state_dict().items())


def test_training_and_scoring_see_the_same_normalized_states(layout, make_episodes) -> None:
    """What the predictor was trained on until it errs nowhere, is worth nothing afterwards.

    With states scored in other units than trained in, as in the published code, it would be.
    """
    rng = np.random.default_rng(1)
    exploration = Rnd(replace(SMALL, epochs=400), layout, rng)
    history = Replay(layout, 4000, 0)
    episodes = make_episodes(layout, 3, rng)
    episodes = replace(episodes, goals=np.zeros((3, layout.episode_steps, 0)))
    episodes.observations[..., :2] = 100.0 + 5.0 * episodes.observations[..., :2]
    new = exploration.observe(episodes)
    exploration.refresh(history, 0, rng)
    states = episodes.observations[:, 1:, :2]
    known = exploration.distillation.errors(states)
    assert known.mean() < 0.02 * new.mean()
    # The first states are their own units; all others those that the predictor learned in.
    z = exploration.distillation.normalized(states).numpy().reshape(-1, 2)
    np.testing.assert_allclose(z.mean(0), 0.0, atol=1e-5)
    np.testing.assert_allclose(z.std(0), 1.0, atol=1e-5)
    np.testing.assert_allclose(exploration.observe(episodes), known)


def test_far_states_are_clipped_and_constant_fields_are_nothing() -> None:
    made = Distillation(SMALL, 2, seed=0)
    made.normalization.update(np.array([[0.0, 3.0], [2.0, 3.0]]))
    z = made.normalized(np.array([[1.0, 3.0], [1e9, 3.0], [-1e9, 4.0]]))
    np.testing.assert_allclose(z, [[0.0, 0.0], [5.0, 0.0], [-5.0, 5.0]])


def test_reward_is_the_stored_bonus_in_units_of_its_sums(layout, make_episodes) -> None:
    rng = np.random.default_rng(2)
    exploration = Rnd(replace(SMALL, intrinsic=2.0), layout, rng)
    history, scale = Replay(layout, 4000, 0), ReturnScale(0.99)
    for k in range(3):
        episodes = make_episodes(layout, 4, rng)
        term = exploration.observe(episodes)
        scale.update(term)
        got = exploration.intrinsic_reward(
            episodes.observations[:, 1:, :2], np.zeros((4, 1, 0)), term
        )
        np.testing.assert_allclose(got, 2.0 * term / scale.deviation)
        told = exploration.refresh(history, k, rng)
        assert told["novelty"] == pytest.approx(term.mean())
        assert told["predictor_loss"] < term.mean()
    raw = Rnd(replace(SMALL, intrinsic=1000.0, scale_bonus=False), layout, rng)
    term = raw.observe(episodes)
    np.testing.assert_allclose(
        raw.intrinsic_reward(np.zeros((4, 40, 2)), np.zeros((4, 1, 0)), term), 1000.0 * term
    )


def ppo_rnd(corridor_config):
    return replace(
        corridor_config,
        learner=PpoConfig(memory=8, heads=(8,), steps_per_update=160, epochs=2, minibatches=2),
        exploration=SMALL,
        rollout=replace(corridor_config.rollout, random_steps=0, noise_probability=0.0),
        total_steps=1000,
    )


def test_trains_and_resumes_bit_identically(tmp_path, make_corridor, corridor_config) -> None:
    config = ppo_rnd(corridor_config)
    whole = resumes_alike(config, make_corridor, tmp_path, 400)
    table = read_metrics(whole)
    # New states are worth less and less: the corridor does not change.
    assert table["novelty"][-1] < 0.5 * table["novelty"][0]
    policy = load_policy(whole)
    assert policy.metadata["method"] == "rnd"
    assert policy.goal.shape == (0,)
    other = replace(config, exploration=replace(SMALL, features=16))
    header = (whole / "config.json").read_text().replace('"features": 32', '"features": 16')
    (whole / "config.json").write_text(header)
    with pytest.raises(CheckpointError, match="of other networks"):
        run_train(replace(other, total_steps=2000), make_corridor(), whole, resume=True)


@pytest.mark.parametrize(
    "change",
    [{"predictor": ()}, {"features": 0}, {"epochs": -1}, {"learning_rate": 0.0}, {"state_clip": 0}],
)
def test_bad_configuration_is_refused(change: dict) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(change))):
        replace(SMALL, **change)
