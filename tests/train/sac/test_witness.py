"""What `benchmarks/sac.py` compares: two updates that are the same, and the products in them."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from plain_sac import PlainSac
from torch import nn
from torch.utils.flop_counter import FlopCounterMode
from update_products import UpdateProducts

from skewmi.train.sac.config import SacConfig
from skewmi.train.sac.sac import Batch, Sac

INPUTS, ACTIONS = 5, 2
CONFIG = SacConfig(hidden=(16, 24), engine="eager", learning_rate=3e-3, initial_temperature=0.2)


def batches(count: int, n: int = 32) -> list[Batch]:
    g = torch.Generator().manual_seed(7)
    return [
        Batch(
            torch.randn(n, INPUTS, generator=g),
            2 * torch.rand(n, ACTIONS, generator=g) - 1,
            torch.randn(n, generator=g),
            torch.randn(n, INPUTS, generator=g),
            0.9 * torch.rand(n, generator=g),
        )
        for _ in range(count)
    ]


def witness_of(sac: Sac) -> PlainSac:
    """The witness with the networks and the noise of a learner of ours."""
    c = sac.config
    plain = PlainSac(
        INPUTS, ACTIONS, hidden=c.hidden, layer_norm=c.layer_norm, polyak=c.polyak,
        learning_rate=c.learning_rate, initial_temperature=c.initial_temperature,
        target_entropy=sac.target_entropy, log_std_bounds=(c.log_std_min, c.log_std_max), seed=0,
    )  # fmt: skip
    with torch.no_grad():
        for theirs, ours in zip(witness_tensors(plain), our_tensors(sac), strict=True):
            theirs.copy_(ours)
    return plain


def witness_tensors(plain: PlainSac) -> list[torch.Tensor]:
    critics = (plain.q1, plain.q2, plain.q1_target, plain.q2_target)
    return [
        *plain.actor.trunk.parameters(),
        *plain.actor.mean.parameters(),
        *plain.actor.log_std.parameters(),
        *(parameter for critic in critics for parameter in critic.parameters()),
        plain.log_temperature,
    ]


def our_tensors(sac: Sac) -> list[torch.Tensor]:
    """In the order and the layout of the witness's."""
    *trunk, head = (layer for layer in sac.actor.body if isinstance(layer, nn.Linear))
    found = [parameter for layer in trunk for parameter in (layer.weight, layer.bias)]
    for half in (slice(None, ACTIONS), slice(ACTIONS, None)):
        found += [head.weight[half], head.bias[half]]
    for critics in (sac.critics, sac.target):
        for member in range(critics.members):
            for weight, bias in zip(critics.weights, critics.biases, strict=True):
                found += [weight[member].T, bias[member, 0]]
    return [*found, sac.log_temperature]


@pytest.mark.parametrize("layer_norm", [True, False])
def test_the_witness_computes_our_update(layer_norm: bool) -> None:
    sac = Sac(replace(CONFIG, layer_norm=layer_norm), INPUTS, ACTIONS, seed=0)
    plain = witness_of(sac)
    before = [tensor.clone() for tensor in our_tensors(sac)]
    for k, batch in enumerate(batches(12)):
        ours = sac.update(batch)
        theirs = plain.update(
            batch.inputs, batch.actions, batch.returns, batch.next_inputs, batch.discounts
        )
        # Adam divides by the size of the gradient, which makes differences of rounding larger.
        tolerance = {"rtol": 1e-5, "atol": 1e-6} if k == 0 else {"rtol": 1e-3, "atol": 1e-4}
        for name, value in theirs.items():
            torch.testing.assert_close(value, ours[name], **tolerance, msg=f"{name}, update {k}")
        for value, own in zip(witness_tensors(plain), our_tensors(sac), strict=True):
            torch.testing.assert_close(value, own, **tolerance)
    assert torch.equal(plain.generator.get_state(), sac.generator.get_state())
    moved = [(a - b).abs().max() for a, b in zip(before, our_tensors(sac), strict=True)]
    assert min(moved) > 1e-4, "something has not learned, so nothing is shown of it"


@pytest.mark.parametrize("hidden", [(16, 24), (32,), (8, 16, 8)])
def test_the_bare_products_are_those_of_an_update(hidden: tuple[int, ...]) -> None:
    sac = Sac(replace(CONFIG, hidden=hidden), INPUTS, ACTIONS, seed=0)
    batch = batches(1)[0]
    bare = UpdateProducts(INPUTS, ACTIONS, hidden, len(batch))
    with FlopCounterMode(display=False) as ours:
        sac.update(batch)
    with FlopCounterMode(display=False) as theirs:
        bare.run()
    assert bare.flops == theirs.get_total_flops() == ours.get_total_flops()
