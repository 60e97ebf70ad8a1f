"""The learner: densities of actions, targets by hand, and that it learns."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.distributions import Normal, TransformedDistribution
from torch.distributions.transforms import TanhTransform

from skewmi.errors import CheckpointError, ConfigurationError
from skewmi.train.sac.config import SacConfig
from skewmi.train.sac.networks import Actor, Critics
from skewmi.train.sac.sac import Batch, Sac
from skewmi.train.state import merge, split

CONFIG = SacConfig(hidden=(32, 32), batch_size=64)


def make_batch(n: int = 64, seed: int = 0) -> Batch:
    g = torch.Generator().manual_seed(seed)
    return Batch(
        inputs=torch.randn(n, 5, generator=g),
        actions=2.0 * torch.rand(n, 2, generator=g) - 1.0,
        returns=torch.randn(n, generator=g),
        next_inputs=torch.randn(n, 5, generator=g),
        discounts=torch.full((n,), 0.9),
    )


def test_action_density_is_torchs() -> None:
    torch.manual_seed(0)
    actor = Actor(5, 2, (32,), (-5.0, 2.0)).double()
    inputs = torch.randn(50, 5, dtype=torch.float64)
    action, log_prob = actor.sample(inputs, torch.randn(50, 2, dtype=torch.float64))
    mean, log_std = actor(inputs)
    squashed = TransformedDistribution(Normal(mean, log_std.exp()), [TanhTransform()])
    torch.testing.assert_close(log_prob, squashed.log_prob(action).sum(-1))


def test_action_density_integrates_to_one_and_stays_finite_at_the_edge() -> None:
    torch.manual_seed(1)
    actor = Actor(3, 1, (16,), (-5.0, 2.0)).double()
    inputs = torch.randn(1, 3, dtype=torch.float64).expand(20_001, -1)
    mean, log_std = actor(inputs)
    u = torch.linspace(-12.0, 12.0, 20_001, dtype=torch.float64)[:, None]
    action, log_prob = actor.sample(inputs, (u - mean) / log_std.exp())
    integral = torch.trapezoid(log_prob.exp(), action[:, 0]).detach()
    assert float(integral) == pytest.approx(1.0, abs=1e-5)
    _, extreme = actor.sample(inputs[:2], torch.full((2, 1), 1e3, dtype=torch.float64))
    assert torch.isfinite(extreme).all()


def test_critics_are_independent_networks() -> None:
    torch.manual_seed(2)
    critics = Critics(2, 4, (8, 8), layer_norm=True)
    inputs = torch.randn(10, 4)
    together = critics(inputs)
    for member in range(2):
        h = inputs
        for k, (weight, bias) in enumerate(zip(critics.weights, critics.biases, strict=True)):
            h = h @ weight[member] + bias[member]
            if k < 2:
                h = torch.relu(torch.nn.functional.layer_norm(h, h.shape[-1:]))
        torch.testing.assert_close(together[member], h[:, 0])


def test_target_by_hand() -> None:
    sac = Sac(CONFIG, 5, 2, seed=0)
    batch = make_batch()
    state = sac.generator.get_state()
    got = sac.targets(batch)
    sac.generator.set_state(state)
    noise = torch.randn((64, 2), generator=sac.generator)
    with torch.no_grad():
        action, log_prob = sac.actor.sample(batch.next_inputs, noise)
        q1, q2 = sac.target(torch.cat((batch.next_inputs, action), 1))
    soft = torch.minimum(q1, q2) - CONFIG.initial_temperature * log_prob
    torch.testing.assert_close(got, batch.returns + 0.9 * soft)


def test_nothing_follows_where_the_discount_is_zero() -> None:
    sac = Sac(CONFIG, 5, 2, seed=0)
    batch = replace(make_batch(), discounts=torch.zeros(64))
    torch.testing.assert_close(sac.targets(batch), batch.returns)


def test_critics_fit_a_fixed_batch() -> None:
    sac = Sac(replace(CONFIG, learning_rate=3e-3), 5, 2, seed=0)
    batch = replace(make_batch(), discounts=torch.zeros(64))
    first = float(sac.update(batch)["critic_loss"])
    for _ in range(400):
        last = float(sac.update(batch)["critic_loss"])
    assert last < 0.02 * first


def test_actor_finds_the_best_action() -> None:
    # One step, reward -|a - a*|^2 with a* = (0.5, -0.3): the mean action must find it.
    best = torch.tensor([0.5, -0.3])
    sac = Sac(replace(CONFIG, learning_rate=3e-3, target_entropy=-6.0), 1, 2, seed=0)
    g = torch.Generator().manual_seed(0)
    for _ in range(600):
        actions = 2.0 * torch.rand(128, 2, generator=g) - 1.0
        sac.update(
            Batch(
                inputs=torch.zeros(128, 1),
                actions=actions,
                returns=-(actions - best).square().sum(1),
                next_inputs=torch.zeros(128, 1),
                discounts=torch.zeros(128),
            )
        )
    torch.testing.assert_close(
        sac.act(torch.zeros(1, 1), deterministic=True)[0], best, atol=0.1, rtol=0.0
    )


def test_temperature_follows_the_entropy() -> None:
    for target, sign in ((5.0, 1), (-20.0, -1)):
        sac = Sac(replace(CONFIG, target_entropy=target), 5, 2, seed=0)
        before = float(sac.log_temperature)
        for _ in range(5):
            sac.update(make_batch())
        assert np.sign(float(sac.log_temperature) - before) == sign


def test_target_critics_move_by_the_polyak_fraction() -> None:
    sac = Sac(CONFIG, 5, 2, seed=0)
    before = [p.clone() for p in sac.target.parameters()]
    sac.update(make_batch())
    for old, new, goal in zip(
        before, sac.target.parameters(), sac.critics.parameters(), strict=True
    ):
        torch.testing.assert_close(new, old + CONFIG.polyak * (goal - old))


def test_state_continues_bit_identically() -> None:
    one, other = Sac(CONFIG, 5, 2, seed=0), Sac(CONFIG, 5, 2, seed=1)
    for k in range(3):
        one.update(make_batch(seed=k))
    # As through the files of a checkpoint.
    tensors, rest = split(one.state_dict())
    stored = {path: tensor.clone() for path, tensor in tensors.items()}
    other.load_state_dict(merge(stored, json.loads(json.dumps(rest))))
    for k in range(3):
        one.update(make_batch(seed=10 + k))
        other.update(make_batch(seed=10 + k))
    (ours, counts), (theirs, other_counts) = split(one.state_dict()), split(other.state_dict())
    assert counts == other_counts
    assert ours.keys() == theirs.keys()
    assert all(torch.equal(ours[k], theirs[k]) for k in ours)


def test_state_of_other_networks_is_refused() -> None:
    sac = Sac(CONFIG, 5, 2, seed=0)
    state = Sac(replace(CONFIG, hidden=(16,)), 5, 2, seed=0).state_dict()
    with pytest.raises(CheckpointError, match="do not fit"):
        sac.load_state_dict(state)


@pytest.mark.parametrize(
    "change", [{"n_step": 0}, {"discount": 1.0}, {"hidden": ()}, {"initial_temperature": 0.0}]
)
def test_bad_configuration_is_refused(change: dict) -> None:
    with pytest.raises(ConfigurationError):
        replace(CONFIG, **change)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_update_on_a_gpu_agrees_with_the_cpu() -> None:
    batch = replace(make_batch(), discounts=torch.zeros(64))
    losses = []
    for device in ("cpu", "cuda"):
        sac = Sac(CONFIG, 5, 2, seed=0, device=device)
        moved = Batch(*(getattr(batch, f).to(device) for f in Batch.__dataclass_fields__))
        losses.append([float(sac.update(moved)["critic_loss"]) for _ in range(3)])
    np.testing.assert_allclose(losses[0], losses[1], rtol=1e-3)
