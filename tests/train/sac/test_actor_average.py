"""An average of the actor's weights, for evaluated episodes and exported policies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from sac_batches import batches
from train_runs import resumes_alike

from skewmi.errors import ConfigurationError
from skewmi.sim import tasks
from skewmi.train.sac.config import SacConfig
from skewmi.train.sac.learner import SacLearner
from skewmi.train.sac.sac import Sac

CONFIG = SacConfig(hidden=(16, 16), engine="eager", learning_rate=3e-3, actor_average=0.8)


def weights(module: torch.nn.Module) -> np.ndarray:
    return torch.cat([p.detach().ravel() for p in module.parameters()]).double().numpy()


def test_average_is_that_of_the_weights_after_every_update() -> None:
    sac, plain = Sac(CONFIG, 5, 2, seed=0), Sac(replace(CONFIG, actor_average=0.0), 5, 2, seed=0)
    assert plain.steady_actor is plain.actor
    met: list[np.ndarray] = []
    expected = weights(sac.actor)
    for k, batch in enumerate(batches(12), start=1):
        sac.update(batch)
        plain.update(batch)
        # What is learned is the same with and without.
        np.testing.assert_array_equal(weights(sac.actor), weights(plain.actor))
        met.append(weights(sac.actor))
        # The mean of all as long as that is shorter, then an exponential one.
        expected = np.mean(met, axis=0) if k <= 5 else 0.8 * expected + 0.2 * met[-1]
        np.testing.assert_allclose(weights(sac.steady_actor), expected, rtol=1e-5, atol=1e-7)
    assert np.abs(weights(sac.steady_actor) - met[-1]).max() > 1e-3


def test_deterministic_actions_and_the_exported_policy_take_the_average() -> None:
    layout = tasks.layout("point_maze")
    learner = SacLearner(CONFIG, layout, layout.state_dim, 0, "cpu")
    sac = learner.sac
    with torch.no_grad():
        for parameter in sac.steady_actor.parameters():
            parameter.mul_(0.5)
    rng = np.random.default_rng(0)
    seen = rng.uniform(layout.observation_low, layout.observation_high, (8, layout.observation_dim))
    goals = np.repeat(seen[:1, : layout.state_dim], 8, axis=0)
    inputs = learner.inputs(seen, goals)
    with torch.no_grad():
        steady = torch.tanh(sac.steady_actor(inputs)[0]).double().numpy()
        latest = torch.tanh(sac.actor(inputs)[0]).double().numpy()
        exported = learner.policy_module(goals[0])(torch.as_tensor(seen).float()).double().numpy()
    assert np.abs(steady - latest).max() > 1e-3
    np.testing.assert_allclose(exported, steady, atol=1e-6)
    acted = learner.act(seen, goals, None, evaluation=8).action
    np.testing.assert_array_equal(acted, steady)
    # Samples are of what is learned.
    state = sac.generator.get_state()
    sampled = learner.act(seen, goals, None, evaluation=0).action
    sac.generator.set_state(state)
    with torch.no_grad():
        expected, _ = sac.actor.sample(inputs, torch.randn((8, 2), generator=sac.generator))
    np.testing.assert_array_equal(sampled, expected.double().numpy())


def test_resumes_with_its_average(tmp_path, make_corridor, corridor_config) -> None:
    learner = replace(corridor_config.learner, actor_average=0.9)
    config = replace(corridor_config, learner=learner, total_steps=800)
    resumes_alike(config, make_corridor, tmp_path, 400)


def test_an_average_begins_at_the_actor_of_a_run_that_had_none() -> None:
    plain = Sac(replace(CONFIG, actor_average=0.0), 5, 2, seed=1)
    for batch in batches(3):
        plain.update(batch)
    sac = Sac(CONFIG, 5, 2, seed=0)
    sac.load_state_dict(plain.state_dict())
    np.testing.assert_array_equal(weights(sac.steady_actor), weights(plain.actor))


@pytest.mark.parametrize("value", [-0.1, 1.0])
def test_a_part_outside_its_range_is_refused(value: float) -> None:
    with pytest.raises(ConfigurationError, match="actor_average"):
        replace(CONFIG, actor_average=value)
