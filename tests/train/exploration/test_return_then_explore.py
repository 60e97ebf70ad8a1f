"""Return-then-explore: what an episode does next, beside a plain account of one episode."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from train_runs import resumes_alike

from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array
from skewmi.train.config import RolloutConfig
from skewmi.train.exploration.return_then_explore import (
    Excursions,
    ReturnThenExplore,
    ReturnThenExploreConfig,
)
from skewmi.train.exploration.skew_explore import SkewExploreConfig
from skewmi.train.learner import Decision
from skewmi.train.ppo.config import PpoConfig
from skewmi.train.rollout import collect
from skewmi.train.runner import Runner

SMALL = {"arrival_radius": 0.4, "go_steps": 12, "stall_steps": 4, "stall_distance": 0.3}


def config(**numbers) -> ReturnThenExploreConfig:
    return ReturnThenExploreConfig(**({"explore_steps": 5, "nearest_of": 1} | SMALL | numbers))


def walks(n: int, steps: int, rng: np.random.Generator) -> Array:
    """Random walks that stand still now and then. Shape (steps, n, 2)."""
    moves = 0.3 * rng.standard_normal((steps, n, 2))
    still = rng.random((steps // 10 + 1, n)).repeat(10, axis=0)[:steps] < 0.3
    moves[still] *= 0.02
    return moves.cumsum(axis=0)


def account(c: ReturnThenExploreConfig, path: Array, goal: Array, fixed: bool, chosen) -> list:
    """One episode step by step: (goal, exploring) of each; `chosen` gives the next goals."""
    told, begun, exploring = [], 0, False
    for now, here in enumerate(path):
        if not exploring and not fixed:
            arrived = np.hypot(*(here - goal)) < c.arrival_radius
            late = now - begun >= c.go_steps
            looked = c.stall_steps > 0 and now - begun >= c.stall_steps
            stalled = looked and np.hypot(*(here - path[now - c.stall_steps])) < c.stall_distance
            if arrived or late or stalled:
                exploring, begun = True, now
        if exploring and now - begun >= c.explore_steps:
            goal, exploring, begun = chosen(now), False, now
        told.append((tuple(goal), exploring))
    return told


@pytest.mark.parametrize(
    "numbers", [{}, {"stall_steps": 0}, {"explore_steps": 0}, {"go_steps": 1, "explore_steps": 1}]
)
def test_episodes_do_what_a_plain_account_of_each_says(numbers: dict) -> None:
    c, rng = config(**numbers), np.random.default_rng(0)
    n, steps = 12, 120
    path, first = walks(n, steps, rng), rng.normal(size=(n, 2))
    proposals = rng.normal(size=(30, 2))
    kept = np.arange(n) < 2
    excursions = Excursions(c, first, kept)
    goals, exploring = np.empty((steps, n, 2)), np.empty((steps, n), dtype=bool)
    for t in range(steps):
        excursions.step(path[t], proposals, rng)
        goals[t], exploring[t] = excursions.goals, excursions.exploring
    for i in range(n):
        expected = account(c, path[:, i], first[i], bool(kept[i]), lambda t, i=i: goals[t, i])
        got = [(tuple(g), bool(e)) for g, e in zip(goals[:, i], exploring[:, i], strict=True)]
        assert got == expected, i
    # Goals come from the proposals, and every reason to end an excursion occurs.
    offered = {tuple(p) for p in proposals} | {tuple(g) for g in first}
    assert {tuple(g) for g in goals.reshape(-1, 2)} <= offered
    assert not exploring[:, :2].any()
    assert (goals[:, :2] == first[:2]).all()
    assert exploring.any() == (c.explore_steps > 0)
    assert len({tuple(g) for g in goals[:, 2:].reshape(-1, 2)}) > n


def test_next_goal_is_the_nearest_of_those_drawn() -> None:
    rng = np.random.default_rng(1)
    c = config(explore_steps=0, go_steps=1, nearest_of=400)
    excursions = Excursions(c, np.full((8, 2), 9.0), np.zeros(8, dtype=bool))
    proposals = rng.normal(size=(6, 2))
    for _ in range(5):
        states = rng.normal(size=(8, 2))
        excursions.step(states, proposals, rng)
    # 400 draws miss one of six with a probability of 1e-32.
    distance = np.linalg.norm(states[:, None] - proposals[None], axis=-1)
    np.testing.assert_array_equal(excursions.goals, proposals[distance.argmin(1)])


def test_next_goal_may_keep_fields_as_they_are() -> None:
    rng = np.random.default_rng(2)
    keep = np.array([0, 2])
    proposals = rng.normal(size=(50, 3))
    for probability in (0.0, 0.3, 1.0):
        c = config(
            explore_steps=0, go_steps=1, keep_fields=("a", "c"), keep_probability=probability
        )
        excursions = Excursions(c, np.full((400, 3), 9.0), np.zeros(400, dtype=bool), keep)
        excursions.step(rng.normal(size=(400, 3)), proposals, rng)
        states = rng.normal(size=(400, 3))
        excursions.step(states, proposals, rng)
        goals = excursions.goals
        stays = goals[:, keep] == states[:, keep]
        # What is not kept is that of one proposal, and what never is kept says which.
        which = (goals[:, None, 1] == proposals[None, :, 1]).argmax(1)
        expected = proposals[which]
        expected[:, keep] = np.where(stays, states[:, keep], expected[:, keep])
        np.testing.assert_array_equal(goals, expected)
        # Four deviations of 400 draws; one does not hang on the other.
        np.testing.assert_allclose(stays.mean(0), probability, atol=0.092)
        np.testing.assert_allclose(stays.all(1).mean(), probability**2, atol=0.092)


def test_next_goal_is_any_visited_state_now_and_then() -> None:
    rng = np.random.default_rng(4)
    n = 2000
    proposals, visited = rng.normal(size=(20, 2)), 7.0 + rng.normal(size=(30, 2))
    for probability in (0.0, 0.4, 1.0):
        c = config(explore_steps=0, go_steps=1, nearest_of=5, revisit_probability=probability)
        excursions = Excursions(c, np.full((n, 2), 90.0), np.zeros(n, dtype=bool))
        excursions.step(rng.normal(size=(n, 2)), proposals, rng, visited)
        excursions.step(rng.normal(size=(n, 2)), proposals, rng, visited)
        is_visited = (excursions.goals[:, None] == visited).all(-1).any(1)
        is_proposal = (excursions.goals[:, None] == proposals).all(-1).any(1)
        assert (is_visited ^ is_proposal).all()
        # Four deviations. However far they are: each as often as any other.
        np.testing.assert_allclose(is_visited.mean(), probability, atol=0.045)
        counts = (excursions.goals[:, None] == visited).all(-1).sum(0)
        assert counts.max(initial=0) <= 3.0 * max(counts.mean(), 1.0)


def test_nearest_is_looked_for_once_fields_are_kept() -> None:
    rng = np.random.default_rng(3)
    c = config(
        explore_steps=0, go_steps=1, nearest_of=400, keep_fields=("b",), keep_probability=1.0
    )
    excursions = Excursions(c, np.full((8, 2), 9.0), np.zeros(8, dtype=bool), np.array([1]))
    # Far in what is kept, near in the rest.
    proposals = np.array([[0.0, 50.0], [3.0, 0.0], [-3.0, 0.0]])
    states = 0.1 * rng.normal(size=(8, 2))
    excursions.step(states, proposals, rng)
    excursions.step(states, proposals, rng)
    np.testing.assert_array_equal(excursions.goals, np.column_stack((np.zeros(8), states[:, 1])))


def in_excursions(base: SkewExploreConfig, **numbers) -> ReturnThenExploreConfig:
    same = {f.name: getattr(base, f.name) for f in fields(SkewExploreConfig)}
    return ReturnThenExploreConfig(**same, **(SMALL | {"explore_steps": 6} | numbers))


def test_who_explores_acts_at_random_and_nobody_else(make_corridor, corridor_config) -> None:
    exploration = in_excursions(corridor_config.exploration)
    rollout = replace(corridor_config.rollout, random_steps=0, noise_probability=0.0)
    runner = Runner(
        replace(corridor_config, exploration=exploration, rollout=rollout), make_corridor()
    )

    class Still:
        def act(self, observations, goals, hidden, evaluation):
            return Decision(np.zeros((len(observations), 2)))

    made = runner.exploration
    assert isinstance(made, ReturnThenExplore)
    told: list[Array] = []
    wandering = made.wandering

    def seen():
        told.append(wandering().copy())
        return told[-1]

    made.wandering = seen  # type: ignore[method-assign]
    episodes = collect(
        runner.env,
        Still(),  # type: ignore[arg-type]
        made,
        runner.generator,
        config=RolloutConfig(noise_probability=0.0, noise_correlation=0.8),
        evaluation=1,
    ).episodes
    who = np.stack(told, axis=1)
    np.testing.assert_array_equal((episodes.actions != 0.0).any(-1), who)
    assert who[1:].any()
    assert not who[0].any()
    np.testing.assert_array_equal(
        episodes.goals[0], np.broadcast_to(made.evaluation_goal, episodes.goals[0].shape)
    )


def test_trains_and_resumes(tmp_path, make_corridor, corridor_config) -> None:
    exploration = in_excursions(corridor_config.exploration)
    rollout = replace(corridor_config.rollout, noise_probability=0.0)
    changed = replace(corridor_config, exploration=exploration, rollout=rollout, total_steps=800)
    resumes_alike(changed, make_corridor, tmp_path, 400)


def test_trains_with_kept_fields_and_refuses_unknown_ones(
    tmp_path, make_corridor, corridor_config
) -> None:
    name = make_corridor().layout.state_fields[0].name
    rollout = replace(corridor_config.rollout, noise_probability=0.0)
    changed = replace(corridor_config, rollout=rollout, total_steps=800)
    kept = in_excursions(corridor_config.exploration, keep_fields=(name,), revisit_probability=0.5)
    resumes_alike(replace(changed, exploration=kept), make_corridor, tmp_path, 400)
    unknown = in_excursions(corridor_config.exploration, keep_fields=("handle",))
    with pytest.raises(ConfigurationError, match="handle"):
        Runner(replace(changed, exploration=unknown), make_corridor())


def test_on_policy_learner_refuses_random_motion(make_corridor, corridor_config) -> None:
    rollout = replace(corridor_config.rollout, random_steps=0, noise_probability=0.0)
    on_policy = replace(corridor_config, rollout=rollout, learner=PpoConfig())
    with pytest.raises(ConfigurationError, match="explore-steps 0"):
        Runner(
            replace(on_policy, exploration=in_excursions(corridor_config.exploration)),
            make_corridor(),
        )
    without = in_excursions(corridor_config.exploration, explore_steps=0)
    Runner(replace(on_policy, exploration=without), make_corridor())


@pytest.mark.parametrize(
    "numbers",
    [
        {"go_steps": 0},
        {"arrival_radius": 0.0},
        {"explore_steps": -1},
        {"nearest_of": 0},
        {"keep_probability": 1.1},
        {"revisit_probability": -0.1},
    ],
)
def test_numbers_that_make_no_sense_are_refused(numbers: dict) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(numbers))):
        config(**numbers)
