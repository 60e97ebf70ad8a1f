"""Which goals are proposed, and how episodes get them."""

from __future__ import annotations

import numpy as np
import pytest

from skewmi.errors import ConfigurationError
from skewmi.train.exploration.goal_plan import GoalSource, plan_goals
from skewmi.train.exploration.goals import (
    SkewedGoals,
    SkewedGoalsConfig,
    left_to_reward,
    propose,
    skew_weights,
)
from skewmi.train.exploration.scale import unit_scale
from skewmi.train.replay import Replay


def test_proposals_prefer_the_rare(layout, make_episodes) -> None:
    rng = np.random.default_rng(6)
    history = Replay(layout, 100 * layout.episode_steps, 2)
    episodes = make_episodes(layout, 100, rng)
    # 95 of 100 episodes sit in one corner, 5 in the other.
    episodes.observations[:95, :, :2] = rng.uniform(0.0, 0.5, size=(95, 41, 2))
    episodes.observations[95:, :, :2] = rng.uniform(3.5, 4.0, size=(5, 41, 2))
    history.add(episodes, np.zeros_like(episodes.rewards))
    scale = unit_scale(layout)
    fraction = {}
    for exponent in (0.0, -1.0, -2.5):
        config = SkewedGoalsConfig(
            history_bandwidth=0.2, proposals=2000, weight_exponent=exponent, running_scale=False
        )
        goals, _ = propose(history, scale, config, rng)
        fraction[exponent] = (goals[:, 0] > 2.0).mean()
        known = history.rows[:100, 1:, :2].reshape(-1, 2)
        assert all(np.isclose(known, goal, atol=1e-5).all(1).any() for goal in goals[:20])
    assert fraction[0.0] == pytest.approx(0.05, abs=0.02)
    assert fraction[-1.0] == pytest.approx(0.5, abs=0.05)  # both corners have the same area
    assert fraction[-2.5] > 0.95


def test_own_count_keeps_one_outlier_from_taking_all_goals(layout, make_episodes) -> None:
    rng = np.random.default_rng(7)
    history = Replay(layout, 100 * layout.episode_steps, 2)
    episodes = make_episodes(layout, 100, rng)
    episodes.observations[:, :, :2] *= 0.5
    episodes.observations[0, 20, :2] = 4.0  # seen once
    history.add(episodes, np.zeros_like(episodes.rewards))
    config = SkewedGoalsConfig(history_bandwidth=0.1, history_points=2000, running_scale=False)
    goals, slots = propose(history, unit_scale(layout), config, rng)
    assert (goals[:, 0] > 3.9).mean() < 0.6
    assert len(slots) == len(goals)


def test_goals_switch_at_the_asked_rate() -> None:
    rng = np.random.default_rng(0)
    proposals = rng.normal(size=(100, 2))
    source = GoalSource(proposals, np.full((5, 2), 7.0), np.array([9.0, 9.0]), 0.3)
    goals = plan_goals(source, 400, 200, 2, 0.05, rng)
    assert (goals[0] == 9.0).all()
    assert (goals[1] == 7.0).all()
    from_rewarded = (goals[2:, 0] == 7.0).all(1)
    assert from_rewarded.mean() == pytest.approx(0.3, abs=0.07)
    assert (goals[2:][from_rewarded] == 7.0).all()
    free = goals[2:][~from_rewarded]
    changes = (free[:, 1:] != free[:, :-1]).any(-1).mean()
    assert changes == pytest.approx(0.05 * 0.99, abs=0.005)


def test_evaluated_episodes_aim_at_rewarded_states_that_differ() -> None:
    proposals, rewarded = np.zeros((10, 2)), np.arange(20.0).reshape(10, 2) + 100.0
    final = np.array([-1.0, -1.0])
    for known in (0, 1, 3, 10):
        source = GoalSource(proposals, rewarded[:known], final, 0.0)
        goals = plan_goals(source, 8, 30, 5, 0.5, np.random.default_rng(known))
        assert (goals[:5] == goals[:5, :1]).all()  # none switches
        assert (goals[5:] == 0.0).all()
        assert (goals[0] == final).all()
        first = goals[1:5, 0]
        if known == 0:
            assert (first == final).all()
            continue
        assert all((goal == rewarded[:known]).all(1).any() for goal in first)
        if known >= 4:
            assert len(np.unique(first, axis=0)) == 4


def test_evaluation_draws_nothing_before_a_reward_is_known() -> None:
    """So that runs are what they were, whatever is evaluated, until there is one."""
    source = GoalSource(np.arange(20.0).reshape(10, 2), np.zeros((0, 2)), np.zeros(2), 0.3)
    after = []
    for evaluation in (0, 1, 5):
        generator = np.random.default_rng(3)
        plan_goals(source, 8, 30, evaluation, 0.1, generator)
        after.append(generator.random())
    assert after[0] == after[1] == after[2]


def test_weights_turn_one_density_into_its_power() -> None:
    rng = np.random.default_rng(5)
    x = rng.normal(size=200_000)
    # Drawn from N(0, 1), weighted with p^e: distributed like p^(1+e) = N(0, 1/(1+e)).
    weights = skew_weights(-0.5 * x**2, -0.5)
    assert weights.sum() == pytest.approx(1.0)
    assert np.sum(weights * x**2) == pytest.approx(1.0 / 0.5, rel=0.05)


def test_weights_of_fields_that_do_not_exist_are_refused(layout) -> None:
    config = SkewedGoalsConfig(field_weights=(("lid", 2.0),))
    with pytest.raises(ConfigurationError, match=r"lid.*fields are .*x.*y"):
        SkewedGoals(config, layout, np.random.default_rng(0))


def test_goals_change_only_when_due(layout, make_episodes) -> None:
    rng = np.random.default_rng(9)
    history = Replay(layout, 100 * layout.episode_steps, 2)
    goals = SkewedGoals(SkewedGoalsConfig(first_refresh_steps=400, refresh_steps=500), layout, rng)
    episodes = make_episodes(layout, 10, rng, paid=0.0)
    history.add(episodes, np.zeros_like(episodes.rewards))
    first = goals.proposals
    goals.observe(episodes)
    goals.refresh(history, 399, rng)
    assert goals.proposals is first
    goals.refresh(history, 400, rng)
    second = goals.proposals
    assert second is not first
    np.testing.assert_array_equal(goals.evaluation_goal, second[-1])
    goals.refresh(history, 899, rng)
    assert goals.proposals is second
    goals.refresh(history, 900, rng)
    assert goals.proposals is not second


@pytest.mark.parametrize("evaluated", [0, 2, 10, 17, 18, 24])
def test_rewarded_goals_leave_episodes_to_explore(evaluated: int) -> None:
    share = evaluated / 25 + (1.0 - evaluated / 25) * left_to_reward(0.7, evaluated / 25)
    assert share == pytest.approx(max(0.7, evaluated / 25))


def test_evaluated_episodes_count_among_those_with_rewarded_goals(layout, make_episodes) -> None:
    rng = np.random.default_rng(12)
    history = Replay(layout, 100 * layout.episode_steps, 2)
    config = SkewedGoalsConfig(rewarded_goal_per_success=1.0, switch_probability=0.0)
    goals = SkewedGoals(config, layout, rng)
    episodes = make_episodes(layout, 10, rng, paid=1.0)
    history.add(episodes, np.zeros_like(episodes.rewards))
    goals.observe(episodes)
    goals.refresh(history, 2_000, rng)
    assert len(goals.source(0.0).rewarded)
    goals.proposals = 99.0 + goals.proposals  # none of them was rewarded
    for evaluated in (0, 12, 16):
        proposed = 0
        for _ in range(100):
            goals.begin(25, evaluated, rng)
            first = goals.planned(0)[evaluated:]
            proposed += (first[:, None] == goals.proposals).all(-1).any(1).sum()
        # 30 % of 2,500, four deviations.
        assert abs(proposed - 750) < 92


def test_state_of_the_goals_continues_alike(layout, make_episodes) -> None:
    rng = np.random.default_rng(10)
    history = Replay(layout, 100 * layout.episode_steps, 2)
    one, other = (SkewedGoals(SkewedGoalsConfig(), layout, rng) for _ in range(2))
    episodes = make_episodes(layout, 10, rng)
    history.add(episodes, np.zeros_like(episodes.rewards))
    one.observe(episodes)
    one.refresh(history, 2_000, rng)
    other.load_state_dict(one.state_dict())
    planned = []
    for goals in (one, other):
        generator = np.random.default_rng(11)
        goals.begin(6, 1, generator)
        planned.append([goals.planned(t) for t in range(layout.episode_steps)])
        goals.refresh(history, 7_000, generator)
    np.testing.assert_array_equal(*planned)
    np.testing.assert_array_equal(one.proposals, other.proposals)
    assert (planned[0][0][0] == planned[0][-1][0]).all()  # evaluation keeps its goal
