"""The update as one CUDA graph computes what the one in single operations does.

Where there is no GPU, its function alone is compared, operation by operation.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import pytest
import torch

from skewmi.errors import CheckpointError, ConfigurationError
from skewmi.train.sac.captured import can_capture
from skewmi.train.sac.config import SacConfig
from skewmi.train.sac.sac import Batch, Sac
from skewmi.train.sac.update_function import named_scalars, state_of, whole_update

CONFIG = SacConfig(hidden=(16, 16), engine="eager", learning_rate=3e-3)
CAPTURED = replace(CONFIG, engine="captured", compile_after=3)
needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA GPU")


def batches(count: int, device: str, n: int = 32) -> list[Batch]:
    g = torch.Generator().manual_seed(5)
    return [
        Batch(
            torch.randn(n, 5, generator=g).to(device),
            (2 * torch.rand(n, 2, generator=g) - 1).to(device),
            torch.randn(n, generator=g).to(device),
            torch.randn(n, 5, generator=g).to(device),
            (0.9 * torch.rand(n, generator=g)).to(device),
        )
        for _ in range(count)
    ]


def tensors(sac: Sac) -> list[torch.Tensor]:
    state, steps = state_of(sac)
    return [*steps, *(tensor for group in state for tensor in group)]


def assert_alike(one: Sac, other: Sac) -> None:
    for value, expected in zip(tensors(one), tensors(other), strict=True):
        torch.testing.assert_close(value, expected, rtol=2e-3, atol=2e-4)


def test_the_function_computes_an_update() -> None:
    one, other = Sac(CONFIG, 5, 2, seed=0), Sac(CONFIG, 5, 2, seed=0)
    given = batches(12, "cpu")
    for batch in given[:2]:
        one.update(batch)
        other.update(batch)
    (state, steps), function = state_of(other), whole_update(other)
    for batch in given[2:]:
        expected = one.update(batch)
        parts = batch.inputs, batch.actions, batch.returns, batch.next_inputs, batch.discounts
        noises = [torch.randn(32, 2, generator=other.generator) for _ in range(2)]
        with torch.no_grad():
            torch._foreach_add_(steps, 1.0)
            got = named_scalars(function(state, steps[0], parts, *noises))
        for name, value in expected.items():
            torch.testing.assert_close(got[name], value.detach(), rtol=2e-4, atol=2e-5)
    assert_alike(one, other)


@needs_gpu
@pytest.mark.parametrize("target_entropy", [None, 0.5])
def test_both_learn_the_same(target_entropy: float | None) -> None:
    one, other = (
        Sac(replace(c, target_entropy=target_entropy), 5, 2, seed=0, device="cuda")
        for c in (CONFIG, CAPTURED)
    )
    kept = []
    for batch in batches(25, "cuda"):
        expected, got = one.update(batch), other.update(batch)
        kept.append((expected, got))
    for expected, got in kept:  # looked at late: no replay may write over what an earlier one said
        assert got.keys() == expected.keys()
        for name, value in expected.items():
            torch.testing.assert_close(got[name], value.detach(), rtol=2e-4, atol=2e-5)
    assert_alike(one, other)
    assert torch.equal(one.generator.get_state(), other.generator.get_state())
    fresh = Sac(CONFIG, 5, 2, seed=0, device="cuda")
    assert not torch.equal(next(fresh.target.parameters()), next(other.target.parameters()))


@needs_gpu
def test_a_batch_of_another_size_is_captured_anew() -> None:
    one, other = (Sac(c, 5, 2, seed=0, device="cuda") for c in (CONFIG, CAPTURED))
    for n in (32, 32, 32, 32, 16, 16, 32):
        (batch,) = batches(1, "cuda", n)
        one.update(batch)
        other.update(batch)
    assert_alike(one, other)


@needs_gpu
def test_goes_on_bit_for_bit_from_its_state() -> None:
    whole = Sac(CAPTURED, 5, 2, seed=0, device="cuda")
    given = batches(12, "cuda")
    for batch in given[:6]:
        whole.update(batch)
    parts = Sac(replace(CAPTURED, engine="auto"), 5, 2, seed=1, device="cuda")
    parts.load_state_dict(deepcopy(whole.state_dict()))  # as from a file
    assert parts.engine == "captured"
    for batch in given[6:]:
        one, other = whole.update(batch), parts.update(batch)
        assert all(torch.equal(one[name], other[name]) for name in one)
    assert all(torch.equal(*pair) for pair in zip(tensors(whole), tensors(parts), strict=True))


def test_without_a_gpu_it_is_refused() -> None:
    assert not can_capture(torch.device("cpu"))
    with pytest.raises(ConfigurationError, match=r"'captured', which needs the device cuda"):
        Sac(CAPTURED, 5, 2, seed=0)
    auto = Sac(replace(CONFIG, engine="auto"), 5, 2, seed=0)
    with pytest.raises(CheckpointError, match=r"captured on a GPU.*--start-from RUN"):
        auto.load_state_dict({**auto.state_dict(), "engine": "captured"})
