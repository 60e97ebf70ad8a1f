"""What a run has visited: covered cells at the grid's ends, differential entropy and its bounds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skewmi.batch_env import GridAxis, TaskMetrics
from skewmi.policy_io import Array
from skewmi.train.config import MetricsConfig
from skewmi.train.metrics import CoverageMetrics, entropy_ceiling
from skewmi.train.replay import Episodes, Replay


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    counts=st.tuples(st.integers(1, 6), st.integers(2, 6)),
    low=st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)),
    beyond=st.floats(0.0, 0.49),
    seed=st.integers(0, 2**31),
)
def test_what_is_a_little_beyond_the_grid_is_in_its_cell_at_that_end(
    layout, counts, low, beyond: float, seed: int
) -> None:
    """On both sides alike: soft stops give way on either."""
    axes = tuple(
        GridAxis(name, a, a + 1.7, n) for name, a, n in zip("xy", low, counts, strict=True)
    )
    rng = np.random.default_rng(seed)
    side = 1.7 / np.array(counts)
    lows = np.array(low)
    inside = lows + rng.uniform(0.01, 1.69, (40, 2))
    expected = np.floor((inside - lows) / side).astype(int)
    moved = inside.copy()
    for axis in (0, 1):
        for row in np.flatnonzero(expected[:, axis] == 0)[::2]:
            moved[row, axis] = lows[axis] - beyond * side[axis]
        for row in np.flatnonzero(expected[:, axis] == counts[axis] - 1)[1::2]:
            moved[row, axis] = lows[axis] + 1.7 + beyond * side[axis]
    seen = []
    for states in (inside, moved):
        coverage = CoverageMetrics(layout, TaskMetrics(grid=axes), MetricsConfig())
        coverage.add(states)
        seen.append(coverage.visited.copy())
    np.testing.assert_array_equal(*seen)
    # Half a cell and more beyond is somewhere else.
    coverage = CoverageMetrics(layout, TaskMetrics(grid=axes), MetricsConfig())
    coverage.add(np.stack((lows - 0.51 * side, lows + 1.7 + 0.51 * side)))
    assert not coverage.visited.any()


def filled_with(layout, states: Array) -> Replay:
    """A history of which these are the states met after a step, in whole episodes."""
    steps = layout.episode_steps
    n = len(states) // steps
    observations = np.zeros((n, steps + 1, layout.observation_dim))
    observations[:, 1:, :2] = states.reshape(n, steps, 2)
    observations[:, 0, :2] = 99.0  # what an episode starts with was not reached
    history = Replay(layout, n * steps, 0)
    actions, rewards = np.zeros((n, steps, layout.action_dim)), np.zeros((n, steps))
    episodes = Episodes(observations, actions, np.zeros((n, steps, 0)), rewards)
    history.add(episodes, np.zeros((n, steps)))
    return history


def measured(layout, states: Array, bandwidth: float, seed: int = 0) -> float:
    """The differential entropy of a history, in its own units."""
    grid = TaskMetrics(grid=(GridAxis("x", 0.0, 4.0, 5), GridAxis("y", 0.0, 4.0, 5)))
    config = MetricsConfig(entropy_bandwidth=bandwidth, entropy_points=50)
    coverage = CoverageMetrics(layout, grid, config)
    one, own = np.random.default_rng(seed), np.random.default_rng(seed + 1)
    return coverage.entropy(filled_with(layout, states), one, own)["differential_entropy"]


def test_states_are_drawn_once_each(layout) -> None:
    """Of fewer states than are asked for, all count, and none meets its own copy."""
    rng = np.random.default_rng(4)
    states = rng.uniform(0.0, 4.0, (3 * layout.episode_steps, 2)).astype(np.float32)
    history = filled_with(layout, states)
    drawn = history.distinct_states(5_000, rng)
    assert sorted(map(tuple, drawn)) == sorted(map(tuple, states.astype(float)))
    few = history.distinct_states(50, rng)
    assert len(few) == len(np.unique(few, axis=0)) == 50
    # By hand, at full precision.
    h, x = 0.2, states.astype(float)
    squared = np.square(x[:, None] - x[None]).sum(-1)
    kernel = np.exp(-0.5 * squared / h**2) / (2 * np.pi * h**2)
    np.fill_diagonal(kernel, 0.0)
    by_hand = -np.log(kernel.sum(1) / (len(x) - 1)).mean()
    for seed in (0, 1):  # so the draw does not matter
        assert measured(layout, states, h, seed) == pytest.approx(by_hand, abs=1e-4)


@pytest.mark.parametrize("spread", [0.05, 0.2, 0.5])
def test_differential_entropy_is_a_cross_entropy(layout, spread: float) -> None:
    """Normal states, s their deviation and h the kernel's: smoothed they are N(0, s^2 + h^2)."""
    rng = np.random.default_rng(8)
    states = spread * rng.standard_normal((100 * layout.episode_steps, 2))
    h, s2 = 0.1, spread**2
    value = measured(layout, states, h)
    cross = np.log(2 * np.pi * (s2 + h**2)) + s2 / (s2 + h**2)
    assert value == pytest.approx(cross, abs=0.05)
    assert value > np.log(2 * np.pi * np.e * s2) - 0.05  # not below their entropy


@pytest.mark.parametrize("kind", ["uniform", "half", "corners", "edge"])
def test_bounds_of_the_differential_entropy(layout, kind: str) -> None:
    """log(area) bounds the entropy, and what is measured of uniform states exceeds it."""
    h, n = 0.1, 100 * layout.episode_steps
    rng = np.random.default_rng(2)
    x = rng.uniform(0.0, 1.0, (n, 2))
    states = {
        "uniform": x,
        "half": x * [0.5, 1.0],
        "corners": np.rint(x) * 0.999,
        "edge": x * [1.0, 0.0],
    }[kind]
    value = measured(layout, states, h)
    assert value < entropy_ceiling(1.0, 2)
    if kind in ("uniform", "half"):
        area = 1.0 if kind == "uniform" else 0.5
        assert np.log(area) < value < np.log(area) + 0.5
    else:
        assert value < 0.0


def test_coverage_in_the_fields_own_units(layout) -> None:
    """As the published code: scaled axes for the entropy, but not for distances."""
    axes = (GridAxis("x", 0.0, 0.2, 5), GridAxis("y", 1.0, 4.0, 5))
    states = np.array([[0.05, 1.5], [0.1, 3.9]])
    scaled = CoverageMetrics(layout, TaskMetrics(grid=axes, unit_range=True), MetricsConfig())
    plain = CoverageMetrics(layout, TaskMetrics(grid=axes), MetricsConfig())
    for coverage in (scaled, plain):
        coverage.add(states[:1])
        coverage.add(states[1:])
    assert "coverage_own_units" not in plain.coverage()
    both = scaled.coverage()
    assert both["coverage_own_units"] == pytest.approx(plain.coverage()["coverage"])
    assert both["coverage_own_units"] != pytest.approx(both["coverage"])
    again = CoverageMetrics(layout, TaskMetrics(grid=axes, unit_range=True), MetricsConfig())
    again.load_state_dict(scaled.state_dict())
    assert again.coverage() == both
