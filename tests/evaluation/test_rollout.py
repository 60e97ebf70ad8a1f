"""Rollouts in a real task, Wilson intervals by their definition, baselines."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skewmi.errors import ConfigurationError, LayoutMismatchError
from skewmi.evaluation.agents import RandomAgent, ZeroAgent
from skewmi.evaluation.rollout import run_episodes, summarise, wilson_interval
from skewmi.policy_io import Array, PolicyLayout
from skewmi.sim import tasks
from skewmi.success import first_success_step, inside_region

TARGET = np.array([-4.0, 0.0])


class Guide:
    """Walks the maze's corridors to the point whose surroundings are rewarded."""

    def __init__(self, layout: PolicyLayout) -> None:
        self.layout = layout
        self.resets = 0

    def reset(self) -> None:
        self.resets += 1

    def act(self, observation: Array) -> Array:
        x, y = observation[..., 0], observation[..., 1]
        column = np.select([np.abs(x + 4.0) < 0.5], [-4.0], 0.0)
        corridor = np.where(y < 0.0, -4.0, 4.0)
        at_height = np.abs(y - corridor) < 0.5
        target_x = np.where(at_height, -4.0, column)
        target_y = np.where(column == -4.0, 0.0, corridor)
        gap = np.stack([target_x - x, target_y - y], axis=-1)
        return np.clip(gap / self.layout.action_scale, -1.0, 1.0)


def test_rollout_is_what_the_environment_did() -> None:
    env = tasks.make_batch("point_maze", 4, start_noise=0.3)
    agent = RandomAgent(env.layout, seed=1)
    episodes = run_episodes(agent, env, 4, seed=5)
    steps = env.layout.episode_steps
    assert episodes.observation.shape == (steps, 4, env.layout.observation_dim)
    assert episodes.action.shape == (steps, 4, env.layout.action_dim)
    observation = env.reset(5)
    for step in range(steps):
        np.testing.assert_array_equal(episodes.observation[step], observation)
        result = env.step(episodes.action[step])
        np.testing.assert_array_equal(episodes.in_region[step], result.success)
        observation = result.observation
    np.testing.assert_array_equal(episodes.final_observation, observation)


def test_equal_seeds_give_equal_episodes_and_others_do_not() -> None:
    env = tasks.make_batch("point_maze", 3, start_noise=0.3)
    agent = ZeroAgent(env.layout)
    first, again, other = (run_episodes(agent, env, 3, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.observation, again.observation)
    assert (first.observation[0] != other.observation[0]).all()


def test_rounds_differ_surplus_is_dropped_and_the_policy_is_reset() -> None:
    env = tasks.make_batch("point_maze", 4, start_noise=0.3)
    agent = Guide(env.layout)
    calls: list[tuple[int, int]] = []
    episodes = run_episodes(agent, env, 6, 0, progress=lambda *done: calls.append(done))
    assert episodes.observation.shape[1] == episodes.success.size == 6
    assert len(np.unique(episodes.observation[0, :, 0])) == 6
    assert agent.resets == 2
    assert calls[-1] == (400, 400)
    assert len(calls) == 400


def test_observer_sees_every_step_that_counts_and_no_surplus() -> None:
    env = tasks.make_batch("point_maze", 4, start_noise=0.3)
    seen: list[Array] = []
    episodes = run_episodes(
        RandomAgent(env.layout, seed=1),
        env,
        6,
        seed=5,
        observer=lambda result, counted: seen.append(result.observation[:counted]),
    )
    steps = env.layout.episode_steps
    assert [len(x) for x in seen] == [4] * steps + [2] * steps
    for columns, rows in ((slice(0, 4), seen[:steps]), (slice(4, 6), seen[steps:])):
        np.testing.assert_array_equal(np.stack(rows[:-1]), episodes.observation[1:, columns])
        np.testing.assert_array_equal(rows[-1], episodes.final_observation[columns])


def test_guided_walk_succeeds_and_standing_still_does_not() -> None:
    env = tasks.make_batch("point_maze", 5, start_noise=0.3)
    walked = run_episodes(Guide(env.layout), env, 5, 0)
    figures = summarise(walked)
    assert figures["successes"] == figures["episodes"] == 5
    assert figures["success_rate"] == 1.0
    states = np.concatenate([walked.observation[1:], walked.final_observation[None]])
    inside = inside_region(env.layout, states)
    np.testing.assert_array_equal(walked.in_region, inside)
    np.testing.assert_array_equal(walked.first_success_step, first_success_step(env.layout, inside))
    stood = summarise(run_episodes(ZeroAgent(env.layout), env, 5, 0))
    assert stood["successes"] == 0
    assert stood["first_success_step"] == {"min": None, "median": None, "mean": None, "max": None}
    json.dumps([figures, stood], allow_nan=False)


def test_another_layout_is_refused() -> None:
    env = tasks.make_batch("point_maze", 2)
    other = dataclasses.replace(env.layout, control_dt=0.05)
    with pytest.raises(LayoutMismatchError, match="control_dt"):
        run_episodes(ZeroAgent(other), env, 2, 0)
    with pytest.raises(ConfigurationError, match="episodes is 0"):
        run_episodes(ZeroAgent(env.layout), env, 0, 0)


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_bounds_are_where_the_score_test_turns(count: tuple[int, int]) -> None:
    """The bounds are the two p with |successes/n - p| = z sqrt(p (1 - p) / n)."""
    successes, n = count
    low, high = wilson_interval(successes, n)
    assert 0.0 <= low <= successes / n <= high <= 1.0
    for p in (low, high):
        z = abs(successes / n - p) / max(math.sqrt(p * (1.0 - p) / n), 1e-300)
        if 0.0 < p < 1.0:
            assert z == pytest.approx(1.959963984540054, rel=1e-6)
    mirrored = wilson_interval(n - successes, n)
    assert mirrored == pytest.approx((1.0 - high, 1.0 - low), abs=1e-12)


def test_wilson_interval_of_a_textbook_case_and_of_nonsense() -> None:
    assert wilson_interval(0, 10) == pytest.approx((0.0, 0.2775328), abs=1e-6)
    for successes, trials in ((-1, 10), (11, 10), (0, 0)):
        with pytest.raises(ConfigurationError):
            wilson_interval(successes, trials)


def test_random_agent_is_uniform_and_reproducible() -> None:
    layout = tasks.layout("point_maze")
    actions = RandomAgent(layout, 3).act(np.zeros((20_000, 2)))
    assert actions.shape == (20_000, 2)
    assert np.abs(actions).max() <= 1.0
    np.testing.assert_allclose(actions.mean(axis=0), 0.0, atol=0.02)
    np.testing.assert_allclose(actions.var(axis=0), 1.0 / 3.0, atol=0.01)
    np.testing.assert_array_equal(actions, RandomAgent(layout, 3).act(np.zeros((20_000, 2))))
    assert ZeroAgent(layout).act(np.zeros(2)).tolist() == [0.0, 0.0]
