"""Why skewed goals raise the entropy of what is visited: the laws, by brute force.

The publication proves two statements in its appendices (Lemma C.1 and the inequality of Lemma D.2).
Its text was not at hand when this was written: these are what its method needs, derived anew, and
they may be worded differently there. `docs/skew-explore.md` has the derivations.

p is what has been visited, w_i ~ p_i^e are the weights of samples of p, so goals come from
q ~ p^(1 + e), and after some more episodes the history is the mixture (1 - c) p + c r of p and
what was visited then, r.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.policy_io import Array
from skewmi.train.density import gaussian_log_density, trajectory_log_density
from skewmi.train.exploration.goals import skew_weights

ROUNDING = 1e-9
LEAST = 1e-12
"""Of a probability: all states are possible, as under a kernel density."""


@st.composite
def distributions(draw: st.DrawFn, size: int | None = None) -> Array:
    """Discrete distributions: flat, peaked, all but concentrated in a point, or uniform."""
    n = draw(st.integers(2, 40)) if size is None else size
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    sharpness = draw(st.sampled_from([0.02, 0.2, 1.0, 20.0, np.inf]))
    p = np.ones(n) if np.isinf(sharpness) else rng.dirichlet(np.full(n, sharpness))
    p = np.maximum(p, LEAST)
    normalized: Array = p / p.sum()
    return normalized


@st.composite
def pairs(draw: st.DrawFn) -> tuple[Array, Array]:
    """Two distributions over the same states."""
    p = draw(distributions())
    return p, draw(distributions(size=len(p)))


def entropy(p: Array) -> float:
    """In nats."""
    return float(-np.sum(p[p > 0.0] * np.log(p[p > 0.0])))


def divergence(p: Array, q: Array) -> float:
    """KL(p, q) of distributions with q > 0 wherever p > 0."""
    here = p > 0.0
    return float(np.sum(p[here] * np.log(p[here] / q[here])))


def skewed(p: Array, exponent: float) -> Array:
    """What goals are distributed like: samples of p, weighted by the code that does it."""
    # n samples of p are, for n to infinity, n p_i copies of state i.
    weighted = p * skew_weights(np.log(p), exponent)
    normalized: Array = weighted / weighted.sum()
    return normalized


@settings(deadline=None)
@given(p=distributions(), one=st.floats(-1.0, 0.0), other=st.floats(-1.0, 0.0))
def test_skewing_raises_the_entropy(p: Array, one: float, other: float) -> None:
    """H(p^(1 + e)) falls with e from -1 to 0: the derivative is -(1 + e) Var(log p) under it."""
    more, less = min(one, other), max(one, other)
    assert entropy(skewed(p, more)) >= entropy(skewed(p, less)) - ROUNDING
    assert entropy(skewed(p, less)) >= entropy(p) - ROUNDING
    assert entropy(skewed(p, -1.0)) == pytest.approx(np.log(len(p)))  # uniform: nothing is above
    # The derivative by finite differences.
    step, e = 1e-4, 0.5 * (more + less)
    slope = (entropy(skewed(p, e + step)) - entropy(skewed(p, e - step))) / (2.0 * step)
    q, log_p = skewed(p, e), np.log(p)
    variance = np.sum(q * log_p**2) - np.sum(q * log_p) ** 2
    assert slope == pytest.approx(-(1.0 + e) * variance, abs=1e-3 * (1.0 + variance))


@settings(deadline=None)
@given(pair=pairs())
def test_skewing_by_an_estimated_density_raises_the_entropy(pair: tuple[Array, Array]) -> None:
    """Weights of an estimate g: the slope at e = 0 is -Cov_p(log p, log g), so being right about
    where it is rare, on average, is enough for some e < 0."""
    p, g = pair
    log_p, log_g = np.log(p), np.log(g)
    covariance = np.sum(p * log_p * log_g) - np.sum(p * log_p) * np.sum(p * log_g)
    step = 1e-5

    def along(e: float) -> float:
        weighted = p * skew_weights(log_g, e)
        return entropy(weighted / weighted.sum())

    slope = (along(step) - along(-step)) / (2.0 * step)
    scale = 1.0 + np.square(log_g).max() * np.abs(log_p).max()
    assert slope == pytest.approx(-covariance, abs=1e-4 * scale)
    if covariance > 1e-3 * scale:
        assert along(-step) > entropy(p)


@settings(deadline=None)
@given(pair=pairs(), c=st.floats(0.0, 1.0))
def test_a_mixture_has_more_entropy_than_its_parts(pair: tuple[Array, Array], c: float) -> None:
    """H((1 - c) p + c r) >= (1 - c) H(p) + c H(r), by the Jensen-Shannon divergence, <= h(c)."""
    p, r = pair
    mixed = (1.0 - c) * p + c * r
    gain = entropy(mixed) - (1.0 - c) * entropy(p) - c * entropy(r)
    shannon = (1.0 - c) * divergence(p, mixed) + c * divergence(r, mixed)
    assert gain == pytest.approx(shannon, abs=1e-9)
    assert -ROUNDING <= gain <= entropy(np.array([c, 1.0 - c])) + ROUNDING


@settings(deadline=None)
@given(p=distributions(), e=st.floats(-1.0, 0.0), c=st.floats(0.0, 1.0))
def test_history_gains_entropy_by_reaching_skewed_goals(p: Array, e: float, c: float) -> None:
    """With exponents from -1 to 0 however much is added, for both laws together."""
    assert entropy((1.0 - c) * p + c * skewed(p, e)) >= entropy(p) - ROUNDING


@settings(deadline=None)
@given(p=distributions(), e=st.floats(-4.0, 0.0))
def test_any_skew_helps_if_little_is_added(p: Array, e: float) -> None:
    """Beyond -1 goals are rarer than uniform ones, and may have less entropy than p; but
    dH/dc at c = 0 is E_q(-log p) - H(p), which is no less than 0 for every e < 0."""
    q = skewed(p, e)
    surprise = float(-np.sum(q * np.log(p)))
    assert surprise >= entropy(p) - ROUNDING
    c = 1e-7
    slope = (entropy((1.0 - c) * p + c * q) - entropy(p)) / c
    assert slope <= surprise - entropy(p) + 1e-6  # the entropy is concave in c
    # For some c it grows, if p is not uniform already. One state a billion times rarer than the
    # others takes a c as small as that.
    if surprise - entropy(p) > 1e-3:
        gains = [entropy((1.0 - c) * p + c * q) - entropy(p) for c in 0.5 ** np.arange(1, 45)]
        assert max(gains) > 0.0


def test_a_skew_beyond_uniform_can_lose_entropy_by_itself() -> None:
    """Why the history is a mixture: one rare state takes all goals, and nothing else is visited."""
    p = np.concatenate((np.full(50, 0.9999 / 50), [0.0001]))
    q = skewed(p, -3.5)
    assert q[-1] > 0.99
    assert entropy(q) < 0.1 < entropy(p)
    assert entropy(0.99 * p + 0.01 * q) > entropy(p)


@settings(deadline=None)
@given(pair=pairs(), seed=st.integers(0, 2**31), goals=st.integers(1, 6))
def test_what_is_paid_bounds_how_far_the_history_is_from_what_was_asked_for(
    pair: tuple[Array, Array], seed: int, goals: int
) -> None:
    """KL(sum_z w_z p_tau(.|z), sum_z w_z p_z) <= sum_z w_z KL(p_tau(.|z), p_z).

    The right side is the mean of log p_tau - log p_z over everything visited, which the intrinsic
    reward keeps down; p_z summed over the goals is their distribution, widened by sigma.
    """
    rng = np.random.default_rng(seed)
    n = len(pair[0])
    weight = rng.dirichlet(np.ones(goals))
    visited = np.maximum(rng.dirichlet(np.ones(n) * rng.choice([0.1, 1.0]), goals), LEAST)
    asked = np.maximum(rng.dirichlet(np.ones(n) * rng.choice([0.1, 1.0]), goals), LEAST)
    visited[0], asked[0] = pair
    visited /= visited.sum(1, keepdims=True)
    asked /= asked.sum(1, keepdims=True)
    paid = sum(w * divergence(v, a) for w, v, a in zip(weight, visited, asked, strict=True))
    assert divergence(weight @ visited, weight @ asked) <= paid + ROUNDING


@settings(deadline=None)
@given(p=distributions(), sigma=st.floats(0.1, 5.0))
def test_exploring_around_goals_raises_the_entropy(p: Array, sigma: float) -> None:
    """Goals of p, widened by p_z: convolution is a mixture of shifts, each as diverse as p."""
    offset = np.arange(len(p))
    around = np.exp(-0.5 * (np.minimum(offset, len(p) - offset) / sigma) ** 2)
    around /= around.sum()
    widened = sum(weight * np.roll(p, shift) for shift, weight in enumerate(around))
    assert entropy(np.asarray(widened)) >= entropy(p) - ROUNDING


@pytest.mark.parametrize("spread", [0.1, 0.4, 0.7, 1.2, 2.0])
def test_the_reward_is_minus_the_divergence(spread: float) -> None:
    """Mean of log p_z - log p_tau over a trajectory of normal states around its goal."""
    sigma, h, n = 0.7, 0.2, 1_000
    rng = np.random.default_rng(6)
    states = 3.0 + spread * rng.standard_normal((4, n, 1))
    p_z = gaussian_log_density(states, np.array([3.0]), sigma)
    mean = float((p_z - trajectory_log_density(states, h, causal=False)).mean())
    # p_tau is N(3, spread^2 + h^2) for many states.
    smooth, s2 = spread**2 + h**2, spread**2
    expected = 0.5 * (np.log(smooth / sigma**2) + s2 / smooth - s2 / sigma**2)
    assert mean == pytest.approx(expected, abs=0.1)
    # That is -KL of the states and p_z, but for the kernels, whose width p_tau has besides.
    exact = 0.5 * (np.log(s2 / sigma**2) + 1.0 - s2 / sigma**2)
    if spread > 2.0 * h:
        assert mean == pytest.approx(exact, abs=0.25)
