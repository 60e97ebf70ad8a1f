"""Advantages against their definition, over random episodes that end in every way."""

from __future__ import annotations

import numpy as np
import pytest

from skewmi.train.ppo.advantages import advantages, explained_variance

GAMMA = 0.93


def random_case(seed: int, terminal: float = 0.15, cut_off: float = 0.15) -> dict:
    rng = np.random.default_rng(seed)
    shape = (6, 25)
    kind = rng.random(shape)
    return {
        "rewards": rng.normal(size=shape),
        "values": rng.normal(size=shape),
        "next_values": rng.normal(size=shape),
        "terminated": kind < terminal,
        "truncated": kind > 1.0 - cut_off,
    }


@pytest.mark.parametrize("decay", [0.0, 0.6, 0.95, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_advantages_are_their_definition(seed: int, decay: float) -> None:
    case = random_case(seed)
    got = advantages(**case, discount=GAMMA, trace_decay=decay)
    n, steps = got.shape
    for i in range(n):
        for t in range(steps):
            expected = 0.0
            for k in range(t, steps):
                after = 0.0 if case["terminated"][i, k] else case["next_values"][i, k]
                delta = case["rewards"][i, k] + GAMMA * after - case["values"][i, k]
                expected += (GAMMA * decay) ** (k - t) * delta
                if case["terminated"][i, k] or case["truncated"][i, k]:
                    break
            assert got[i, t] == pytest.approx(expected, abs=1e-12), (seed, i, t)


def test_without_traces_decaying_the_target_is_the_return() -> None:
    """lambda = 1: A + V is the discounted reward, and the value where only the time ended."""
    case = random_case(11, terminal=0.0, cut_off=0.0)
    case["next_values"][:, :-1] = case["values"][:, 1:]
    for terminal in (True, False):
        flags = np.zeros_like(case["truncated"])
        flags[:, -1] = True
        case |= {"terminated": flags & terminal, "truncated": flags & (not terminal)}
        got = advantages(**case, discount=GAMMA, trace_decay=1.0) + case["values"]
        steps = got.shape[1]
        for t in range(steps):
            powers = GAMMA ** np.arange(steps - t)
            expected = case["rewards"][:, t:] @ powers
            if not terminal:
                expected = expected + GAMMA ** (steps - t) * case["next_values"][:, -1]
            np.testing.assert_allclose(got[:, t], expected, atol=1e-12)


def test_episodes_do_not_see_each_other() -> None:
    """What comes after an end changes nothing before it; after a terminal state, not even it."""
    case = random_case(3, terminal=0.0, cut_off=0.0)
    case["terminated"][:3, 12] = case["truncated"][3:, 12] = True
    before = advantages(**case, discount=GAMMA, trace_decay=0.9)
    for name in ("rewards", "values", "next_values"):
        case[name] = case[name].copy()
        case[name][:, 13:] += 100.0
    after = advantages(**case, discount=GAMMA, trace_decay=0.9)
    np.testing.assert_array_equal(before[:, :13], after[:, :13])
    case["next_values"][:, 12] += 1.0
    cut_off = advantages(**case, discount=GAMMA, trace_decay=0.9)
    np.testing.assert_array_equal(cut_off[:3, :13], before[:3, :13])
    np.testing.assert_allclose(cut_off[3:, 12], before[3:, 12] + GAMMA)


def test_explained_variance() -> None:
    returns = np.random.default_rng(1).normal(size=(4, 9))
    assert explained_variance(returns, returns) == 1.0
    assert explained_variance(np.full_like(returns, 3.0), returns) == pytest.approx(0.0)
    assert explained_variance(-returns, returns) == pytest.approx(-3.0)
    assert explained_variance(returns, np.zeros_like(returns)) == 0.0
