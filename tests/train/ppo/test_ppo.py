"""The loss over sequences is that of its steps, one by one; and it is optimized."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.distributions import Independent, Normal

from skewmi.errors import CheckpointError, ConfigurationError
from skewmi.train.ppo.config import PpoConfig
from skewmi.train.ppo.networks import gaussian_entropy, log_density
from skewmi.train.ppo.ppo import Ppo
from skewmi.train.ppo.sequences import Sequences, cut
from skewmi.train.state import merge, split

CONFIG = PpoConfig(
    memory=6, heads=(8,), value_clip=0.3, entropy_weight=0.01, epochs=2, minibatches=3
)
EPISODES, STEPS, INPUTS, ACTIONS = 4, 11, 5, 2


def collected(ppo: Ppo, length: int, seed: int = 0) -> Sequences:
    """Episodes as a policy of another time drew them, cut; float64."""
    g = torch.Generator().manual_seed(seed)

    def random(*shape: int) -> Tensor:
        return torch.randn(EPISODES, STEPS, *shape, generator=g, dtype=torch.float64)

    memory = [0.5 * random(ppo.config.memory) for _ in range(2 if ppo.config.memory else 0)]
    pieces = {
        "inputs": random(INPUTS),
        "actions": random(ACTIONS),
        "log_density": -2.8 + 0.3 * random(),
        "advantages": random(),
        "returns": random(),
        "values": 0.5 * random(),
        "real": torch.ones(EPISODES, STEPS, dtype=torch.bool),
    }
    hidden = tuple(part[:, ::length].flatten(0, 1) for part in memory)
    return Sequences(**{k: cut(v, length) for k, v in pieces.items()}, hidden=hidden)


def double(config: PpoConfig = CONFIG, seed: int = 0) -> Ppo:
    ppo = Ppo(config, INPUTS, ACTIONS, seed)
    ppo.network.double()
    return ppo


def lstm_step(lstm: torch.nn.LSTM, x: Tensor, h: Tensor, c: Tensor) -> tuple[Tensor, Tensor]:
    """The equations of an LSTM, for one step of one sequence."""
    gates = lstm.weight_ih_l0 @ x + lstm.bias_ih_l0 + lstm.weight_hh_l0 @ h + lstm.bias_hh_l0
    i, f, g, o = gates.chunk(4)
    c = torch.sigmoid(f) * c + torch.sigmoid(i) * torch.tanh(g)
    return torch.sigmoid(o) * torch.tanh(c), c


def step_by_step(ppo: Ppo, batch: Sequences) -> Tensor:
    """The loss, a step at a time; memory goes on inside a sequence and begins as stored."""
    c, net = ppo.config, ppo.network
    told = []
    for k in range(len(batch)):
        h, cell = (part[k] for part in batch.hidden)
        for t in range(batch.inputs.shape[1]):
            if not batch.real[k, t]:
                continue
            h, cell = lstm_step(net.lstm, batch.inputs[k, t], h, cell)
            policy = Independent(Normal(net.policy(h), net.log_std.exp()), 1)
            ratio = torch.exp(policy.log_prob(batch.actions[k, t]) - batch.log_density[k, t])
            value, old = net.value(h)[0], batch.values[k, t]
            error = (value - batch.returns[k, t]) ** 2
            near = old + torch.clip(value - old, -c.value_clip, c.value_clip)
            error = torch.maximum(error, (near - batch.returns[k, t]) ** 2)
            told.append((ratio, batch.advantages[k, t], error, policy.entropy()))
    ratios, given, errors, entropies = (torch.stack(part) for part in zip(*told, strict=True))
    given = (given - given.mean()) / given.std(correction=0)
    gains = torch.minimum(ratios * given, torch.clip(ratios, 1 - c.clip, 1 + c.clip) * given)
    per_step = -gains + 0.5 * c.value_weight * errors - c.entropy_weight * entropies
    return per_step.mean()


def gradients(ppo: Ppo, loss: Tensor) -> dict[str, Tensor]:
    names, parameters = zip(*ppo.network.named_parameters(), strict=True)
    return dict(zip(names, torch.autograd.grad(loss, parameters), strict=True))


@pytest.mark.parametrize("length", [1, 4, STEPS])  # one step, padded at the end, whole episodes
def test_gradient_over_sequences_is_that_of_single_steps(length: int) -> None:
    ppo = double()
    batch = collected(ppo, length)
    loss, told = ppo.loss(batch)
    expected = step_by_step(ppo, batch)
    torch.testing.assert_close(loss, expected, rtol=0.0, atol=1e-7)
    ours, theirs = gradients(ppo, loss), gradients(ppo, expected)
    for name in ours:
        torch.testing.assert_close(ours[name], theirs[name], rtol=1e-6, atol=1e-9, msg=name)
        assert ours[name].abs().max() > 0.0, name
    # Both sides of every kink were met.
    assert 0.0 < float(told["clipped_fraction"]) < 1.0


def test_gradient_is_that_of_finite_differences() -> None:
    ppo = double()
    batch = collected(ppo, 4)
    ours = gradients(ppo, ppo.loss(batch)[0])
    step = 1e-6
    with torch.no_grad():
        for name, parameter in ppo.network.named_parameters():
            flat = parameter.view(-1)
            for index in (0, len(flat) // 2, len(flat) - 1):
                kept = flat[index].item()
                sides = []
                for sign in (1.0, -1.0):
                    flat[index] = kept + sign * step
                    sides.append(float(ppo.loss(batch)[0]))
                flat[index] = kept
                slope = (sides[0] - sides[1]) / (2.0 * step)
                assert float(ours[name].view(-1)[index]) == pytest.approx(slope, abs=1e-6), name


def test_gradients_go_back_to_the_first_step_of_a_sequence_and_no_further() -> None:
    ppo = double()
    whole = collected(ppo, STEPS)
    for length in (STEPS, 4):
        inputs = whole.inputs.clone().requires_grad_()
        pieces = cut(inputs, length)
        per_episode = len(pieces) // EPISODES
        batch = collected(ppo, length)
        mean, _, _ = ppo.network(pieces, batch.hidden)
        last = mean.reshape(EPISODES, per_episode * length, ACTIONS)[:, STEPS - 1].sum()
        (reached,) = torch.autograd.grad(last, inputs)
        first = STEPS - 1 - (STEPS - 1) % length
        assert (reached[:, first:].abs().amax(-1) > 0.0).all()
        assert not reached[:, :first].any()


def test_padding_counts_for_nothing() -> None:
    ppo = double()
    batch = collected(ppo, 4)
    assert int((~batch.real).sum()) == EPISODES
    loss = ppo.loss(batch)[0]
    other = {
        name: torch.where(batch.real, getattr(batch, name), torch.full_like(batch.values, 7.0))
        for name in ("log_density", "advantages", "returns", "values")
    }
    real = batch.real[..., None]
    other["inputs"] = torch.where(real, batch.inputs, torch.full_like(batch.inputs, 7.0))
    other["actions"] = torch.where(real, batch.actions, torch.full_like(batch.actions, 7.0))
    changed = ppo.loss(replace(batch, **other))[0]
    torch.testing.assert_close(changed, loss, rtol=0.0, atol=0.0)


def test_sequences_of_an_episode_are_the_episode() -> None:
    ppo = double()
    x = torch.randn(EPISODES, STEPS, INPUTS, dtype=torch.float64)
    means, values, _ = ppo.network(x, ppo.network.empty(EPISODES))
    hidden = ppo.network.empty(EPISODES)
    for t in range(STEPS):
        mean, value, hidden = ppo.network(x[:, t : t + 1], hidden)
        torch.testing.assert_close(mean[:, 0], means[:, t])
        torch.testing.assert_close(value[:, 0], values[:, t])


def test_densities_are_torchs() -> None:
    g = torch.Generator().manual_seed(1)
    action, mean = torch.randn(2, 50, 3, generator=g, dtype=torch.float64)
    log_std = torch.randn(3, generator=g, dtype=torch.float64)
    normal = Independent(Normal(mean, log_std.exp()), 1)
    torch.testing.assert_close(log_density(action, mean, log_std), normal.log_prob(action))
    torch.testing.assert_close(gaussian_entropy(log_std).expand(50), normal.entropy())


def test_policy_and_value_go_where_they_should() -> None:
    """One state, reward -|a - a*|^2: the mean finds a*, the value its expectation."""
    best = torch.tensor([0.5, -0.3])
    config = replace(
        PpoConfig(), memory=0, heads=(16,), learning_rate=1e-2, initial_log_std=-1.0,
        epochs=4, minibatches=2,
    )  # fmt: skip
    ppo = Ppo(config, 1, 2, seed=0)
    n = 256
    for _ in range(40):
        action, density, values, _ = ppo.act(torch.zeros(n, 1), (), 0)
        reward = -(action - best).square().sum(1)
        batch = Sequences(
            inputs=torch.zeros(n, 1, 1),
            actions=action[:, None],
            log_density=density[:, None],
            advantages=(reward - values)[:, None],
            returns=reward[:, None],
            values=values[:, None],
            real=torch.ones(n, 1, dtype=torch.bool),
            hidden=(),
        )
        ppo.update(batch)
    mean, _, values, _ = ppo.act(torch.zeros(1, 1), (), deterministic=1)
    torch.testing.assert_close(mean[0], best, atol=0.1, rtol=0.0)
    variance = float((2.0 * ppo.network.log_std.detach()).exp().sum())
    assert variance < 2.0 * math.exp(-2.0)  # it became surer
    assert float(values[0]) == pytest.approx(-variance, abs=0.1)


def test_first_ratios_are_one_and_every_step_is_seen_in_every_epoch() -> None:
    ppo = double(replace(CONFIG, epochs=1, minibatches=1))
    batch = collected(ppo, 4)
    mean, _, _ = ppo.network(batch.inputs, batch.hidden)
    own = log_density(batch.actions, mean, ppo.network.log_std).detach()
    told = ppo.update(replace(batch, log_density=own))
    assert told["divergence"] == pytest.approx(0.0, abs=1e-20)
    assert told["clipped_fraction"] == 0.0
    assert told["policy_loss"] == pytest.approx(0.0, abs=1e-9)  # centered advantages
    ppo = double(replace(CONFIG, epochs=3, minibatches=5))
    seen: list[int] = []
    loss = ppo.loss

    def watched(part: Sequences) -> tuple[Tensor, dict[str, Tensor]]:
        seen.extend(np.flatnonzero((batch.inputs[:, None] == part.inputs).all((2, 3)).any(1)))
        return loss(part)

    ppo.loss = watched  # type: ignore[method-assign]
    ppo.update(batch)
    assert ppo.updates == 15
    assert np.bincount(seen).tolist() == [3] * len(batch)


def test_state_continues_bit_identically() -> None:
    one, other = double(), double(seed=1)
    one.update(collected(one, 4))
    # As through the files of a checkpoint.
    tensors, rest = split(one.state_dict())
    stored = {path: tensor.clone() for path, tensor in tensors.items()}
    other.load_state_dict(merge(stored, json.loads(json.dumps(rest))))
    for ppo in (one, other):
        ppo.update(collected(ppo, 4, seed=2))
    (ours, counts), (theirs, other_counts) = split(one.state_dict()), split(other.state_dict())
    assert counts == other_counts
    assert ours.keys() == theirs.keys()
    assert all(torch.equal(ours[k], theirs[k]) for k in ours)


def test_state_of_another_network_is_refused() -> None:
    state = double(replace(CONFIG, memory=5)).state_dict()
    with pytest.raises(CheckpointError, match="do not fit"):
        double().load_state_dict(state)


@pytest.mark.parametrize(
    "change",
    [
        {"memory": -1},
        {"heads": (0,)},
        {"epochs": 0},
        {"minibatches": 0},
        {"sequence_length": 0},
        {"discount": 1.0},
        {"trace_decay": 1.1},
        {"clip": 0.0},
        {"value_clip": -1.0},
    ],
)
def test_bad_configuration_is_refused(change: dict) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(change))):
        replace(CONFIG, **change)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_loss_on_a_gpu_agrees_with_the_cpu() -> None:
    batch = collected(double(), 4)
    losses = []
    for device in ("cpu", "cuda"):
        ppo = Ppo(CONFIG, INPUTS, ACTIONS, 0, device)
        moved = {
            name: getattr(batch, name).to(device)
            for name in Sequences.__dataclass_fields__
            if name != "hidden"
        }
        moved = {k: v if k == "real" else v.float() for k, v in moved.items()}
        hidden = tuple(part.float().to(device) for part in batch.hidden)
        told = ppo.update(Sequences(**moved, hidden=hidden))
        losses.append([told["policy_loss"], told["value_loss"]])
    np.testing.assert_allclose(losses[0], losses[1], rtol=1e-3)
