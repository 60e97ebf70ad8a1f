"""The history against brute force, on episodes made up at random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skewmi.train.exploration.goals import SkewedGoalsConfig, propose
from skewmi.train.exploration.scale import unit_scale
from skewmi.train.replay import Replay


@pytest.mark.parametrize("n_step", [1, 3, 7])
def test_drawn_transitions_are_those_of_the_episodes(filled, layout, n_step: int) -> None:
    history, episodes, term = filled
    drawn = history.draw(500, n_step, 0.25, np.random.default_rng(1))
    steps = layout.episode_steps
    for i in range(500):
        e, t = drawn.episode[i], drawn.step[i]
        length = min(n_step, steps - t)
        assert drawn.length[i] == length
        assert drawn.at_end[i] == (t + length == steps)
        np.testing.assert_allclose(drawn.observation[i], episodes.observations[e, t], rtol=1e-6)
        np.testing.assert_allclose(drawn.action[i], episodes.actions[e, t], rtol=1e-6)
        np.testing.assert_allclose(drawn.goal[i], episodes.goals[e, t], rtol=1e-6)
        last = episodes.observations[e, t + length]
        np.testing.assert_allclose(drawn.next_observation[i], last, rtol=1e-6)
        for k in range(length):
            state = episodes.observations[e, t + k + 1, :2]
            np.testing.assert_allclose(drawn.states[i, k], state, rtol=1e-6)
            np.testing.assert_allclose(drawn.trajectory_term[i, k], term[e, t + k], rtol=1e-6)
            assert drawn.rewards[i, k] == episodes.rewards[e, t + k]


def test_rewarded_episodes_are_drawn_more_often(layout, make_episodes) -> None:
    rng = np.random.default_rng(4)
    history = Replay(layout, 100 * layout.episode_steps, 2)
    none = make_episodes(layout, 99, rng, paid=0.0)
    history.add(none, np.zeros_like(none.rewards))
    assert len(history.rewarded_states(10, rng)) == 0
    one = make_episodes(layout, 1, rng, paid=1.0)
    history.add(one, np.zeros_like(one.rewards))
    drawn = history.draw(4000, 1, 0.25, rng)
    expected = 0.25 + 0.75 / 100
    assert (drawn.episode == 99).mean() == pytest.approx(expected, abs=0.03)
    states = history.rewarded_states(10, rng)
    assert len(states) == 10
    assert all(np.isclose(one.observations[0, 1:, :2], s, rtol=1e-6).all(1).any() for s in states)


def test_ring_keeps_the_latest(layout, make_episodes) -> None:
    rng = np.random.default_rng(5)
    history = Replay(layout, 10 * layout.episode_steps, 2)
    for k in range(7):
        episodes = make_episodes(layout, 3, rng, paid=0.0)
        history.add(replace(episodes, actions=np.full_like(episodes.actions, k)), episodes.rewards)
    assert len(history) == 10
    drawn = history.draw(2000, 1, 0.0, rng)
    assert set(np.unique(drawn.action)) == {3.0, 4.0, 5.0, 6.0}


def test_goals_are_those_that_the_episodes_pursued(layout, make_episodes) -> None:
    rng = np.random.default_rng(6)
    history = Replay(layout, 10 * layout.episode_steps, 2)
    episodes = make_episodes(layout, 3, rng, paid=0.0)
    episodes = replace(episodes, goals=rng.normal(size=episodes.goals.shape))
    history.add(episodes, episodes.rewards)
    slots = np.array([2, 0])
    np.testing.assert_allclose(history.goal_columns(slots), episodes.goals[slots], rtol=1e-6)


def test_a_fraction_of_a_batch_comes_from_the_episodes_of_the_proposals(
    layout, make_episodes
) -> None:
    rng = np.random.default_rng(8)
    history = Replay(layout, 100 * layout.episode_steps, 2)
    episodes = make_episodes(layout, 100, rng)
    episodes.rewards[:] = 0.0
    episodes.rewards[3] = 1.0
    episodes.observations[:, :, :2] = rng.uniform(0.0, 0.5, size=(100, 41, 2))
    episodes.observations[95:, :, :2] = rng.uniform(3.5, 4.0, size=(5, 41, 2))
    history.add(episodes, np.zeros_like(episodes.rewards))
    config = SkewedGoalsConfig(history_bandwidth=0.2, proposals=500, running_scale=False)
    goals, slots = propose(history, unit_scale(layout), config, rng)
    np.testing.assert_array_equal(slots >= 95, goals[:, 0] > 2.0)
    drawn = history.draw(8000, 1, 0.25, rng, rare=slots, rare_fraction=0.25).episode
    # The rest is uniform over 100 episodes.
    assert (drawn >= 95).mean() == pytest.approx(0.25 + 0.5 * 0.05, abs=0.03)
    assert (drawn == 3).mean() == pytest.approx(0.25 + 0.5 * 0.01, abs=0.03)
    drawn = history.draw(8000, 1, 0.0, rng, rare=slots[:0], rare_fraction=0.25).episode
    assert (drawn >= 95).mean() == pytest.approx(0.05, abs=0.02)
