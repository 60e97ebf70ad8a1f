"""What every task promises, whichever it is."""

from __future__ import annotations

import json

import numpy as np
import pytest

from skewmi.batch_env import BatchEnv
from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.sim import tasks

NUM_ENVS = 3
STEPS = 15

RANDOMISED: dict[str, dict[str, object]] = {
    "open_press_close": {},
    "door_open": {},
    "point_maze": {"start_noise": 0.2},
}
"""Options with which resets differ; a task that is not here is not tested, which fails below."""


@pytest.fixture(scope="module", params=tasks.names())
def task(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


@pytest.fixture(scope="module")
def env(task: str) -> BatchEnv:
    return tasks.make_batch(task, NUM_ENVS, num_threads=1, time_input=True, **RANDOMISED[task])


def random_actions(layout: PolicyLayout, steps: int = STEPS, seed: int = 0) -> Array:
    generator = np.random.default_rng(seed)
    # Slowly varying, so that something happens: white noise stays where it is.
    drift = generator.uniform(-1.0, 1.0, (1, NUM_ENVS, layout.action_dim))
    noise = generator.uniform(-1.0, 1.0, (steps, NUM_ENVS, layout.action_dim))
    return np.clip(drift + 0.5 * noise, -1.0, 1.0)


def roll_out(env: BatchEnv, seed: int | None, steps: int = STEPS) -> Array:
    """Observations of an episode's start. Shape (steps + 1, NUM_ENVS, observation_dim)."""
    observations = [env.reset(seed)]
    observations += [env.step(a).observation for a in random_actions(env.layout, steps)]
    return np.stack(observations)


def test_observations_match_the_layout(task: str, env: BatchEnv) -> None:
    assert env.num_envs == NUM_ENVS
    assert env.layout.task == task
    assert env.layout.hash() == tasks.layout(task, time_input=True).hash()
    first = env.reset(0)
    assert first.shape == (NUM_ENVS, env.layout.observation_dim)
    assert first.dtype == np.float64
    for action in random_actions(env.layout):
        result = env.step(action)
        assert result.observation.shape == first.shape
        assert result.observation.dtype == np.float64
        assert np.isfinite(result.observation).all()
        assert result.reward.shape == result.success.shape == (NUM_ENVS,)
        assert result.success.dtype == np.bool_
        assert isinstance(result.truncated, bool)


def test_observations_stay_near_their_nominal_range(env: BatchEnv) -> None:
    observations = roll_out(env, 3)
    low, high = env.layout.observation_low, env.layout.observation_high
    margin = 0.5 * (high - low)  # the range scales, it does not clip; contact pushes the hand
    assert (observations >= low - margin).all()
    assert (observations <= high + margin).all()


def test_time_counts_the_steps_of_the_episode(env: BatchEnv) -> None:
    time = roll_out(env, 0)[..., -1]
    expected = np.arange(STEPS + 1) / env.layout.episode_steps
    np.testing.assert_array_equal(time, np.repeat(expected[:, None], NUM_ENVS, axis=1))


def test_actions_move_something_in_every_environment(env: BatchEnv) -> None:
    state = roll_out(env, 0)[..., : env.layout.state_dim]
    moved = (
        np.ptp(state, axis=0)
        / np.ptp([env.layout.observation_low, env.layout.observation_high], axis=0)[
            : env.layout.state_dim
        ]
    )
    assert (moved.max(axis=-1) > 0.02).all()


def test_same_seed_gives_the_same_trajectory(env: BatchEnv) -> None:
    first = roll_out(env, 7)
    roll_out(env, 8)  # history must not matter
    np.testing.assert_array_equal(roll_out(env, 7), first)


def test_trajectory_depends_neither_on_threads_nor_on_the_object(task: str, env: BatchEnv) -> None:
    other = tasks.make_batch(
        task, NUM_ENVS, num_threads=2, seed=7, time_input=True, **RANDOMISED[task]
    )
    np.testing.assert_array_equal(roll_out(other, None), roll_out(env, 7))


def test_environments_do_not_disturb_each_other(env: BatchEnv) -> None:
    actions = random_actions(env.layout)
    trajectories = []
    for changed in (False, True):
        env.reset(5)
        if changed:
            actions[:, 0] *= -1.0
        trajectories.append(np.stack([env.step(action).observation for action in actions]))
    np.testing.assert_array_equal(trajectories[0][:, 1:], trajectories[1][:, 1:])
    assert (trajectories[0][:, 0] != trajectories[1][:, 0]).any()


def test_resets_differ_between_environments_episodes_and_seeds(env: BatchEnv) -> None:
    starts = np.concatenate([env.reset(1), env.reset(), env.reset(2)])
    assert len(np.unique(starts, axis=0)) == len(starts)


def test_arrays_are_not_shared(env: BatchEnv) -> None:
    arrays = [env.reset(0)]
    for action in random_actions(env.layout, 3):
        result = env.step(action)
        arrays += [result.observation, result.reward, result.success]
    copies = [array.copy() for array in arrays]
    for array in arrays:
        array[:] = True
    # Neither each other's memory nor the environment's.
    clean = roll_out(env, 0, 3)
    np.testing.assert_array_equal(copies[0], clean[0])
    for step in range(3):
        np.testing.assert_array_equal(copies[1 + 3 * step], clean[step + 1])
    for index, array in enumerate(arrays):
        assert not any(np.shares_memory(array, other) for other in arrays[index + 1 :])


def test_actions_are_left_alone_and_clipped(env: BatchEnv) -> None:
    env.reset(0)
    big = np.full((NUM_ENVS, env.layout.action_dim), 7.0)
    first = env.step(big).observation
    assert (big == 7.0).all()
    env.reset(0)
    np.testing.assert_array_equal(env.step(np.ones_like(big)).observation, first)


def test_step_reward_is_compute_reward_of_the_state(env: BatchEnv) -> None:
    env.reset(0)
    for action in random_actions(env.layout):
        result = env.step(action)
        state = result.observation[:, : env.layout.state_dim]
        np.testing.assert_array_equal(result.reward, env.compute_reward(state))
        np.testing.assert_array_equal(result.reward, result.success.astype(float))


def test_compute_reward_pays_at_the_centre_of_the_region_and_not_outside(env: BatchEnv) -> None:
    layout = env.layout
    names = layout.observation_names
    centre = 0.5 * (layout.observation_low + layout.observation_high)[: layout.state_dim]
    for ball in layout.reward_region:
        centre[[names.index(name) for name in ball.fields]] = ball.centre
    assert env.compute_reward(centre) == 1.0
    for ball in layout.reward_region:
        column = names.index(ball.fields[0])
        outside = np.tile(centre, (2, 3, 1))
        outside[..., column] += ball.radius * 1.001
        np.testing.assert_array_equal(env.compute_reward(outside), np.zeros((2, 3)))


def test_visited_states_are_reachable(env: BatchEnv) -> None:
    state = roll_out(env, 0)[..., : env.layout.state_dim]
    reachable = env.reachable(state)
    assert reachable.shape == state.shape[:-1]
    assert reachable.all()


def test_reachable_refuses_states_far_outside(env: BatchEnv) -> None:
    layout = env.layout
    span = (layout.observation_high - layout.observation_low)[: layout.state_dim]
    far = layout.observation_high[: layout.state_dim] + 3.0 * span
    assert not env.reachable(far)


def test_random_state_round_trips_through_json(env: BatchEnv) -> None:
    env.reset(11)
    state = json.loads(json.dumps(env.random_state()))
    expected = [env.reset(), env.reset()]
    env.reset(12)
    env.set_random_state(state)
    np.testing.assert_array_equal([env.reset(), env.reset()], expected)


@pytest.mark.parametrize("state", [{}, {"start": 3}, {"generator": "x"}])
def test_a_foreign_random_state_is_refused(env: BatchEnv, state: dict[str, object]) -> None:
    with pytest.raises(ConfigurationError, match="random state"):
        env.set_random_state(state)


def test_episode_ends_together_after_its_steps_and_needs_a_reset(task: str) -> None:
    env = tasks.make_batch(task, 1, num_threads=1)
    action = np.zeros((1, env.layout.action_dim))
    with pytest.raises(ConfigurationError, match="reset"):
        env.step(action)
    env.reset()
    truncated = [env.step(action).truncated for _ in range(env.layout.episode_steps)]
    assert truncated == [False] * (env.layout.episode_steps - 1) + [True]
    with pytest.raises(ConfigurationError, match="reset"):
        env.step(action)
    env.reset()
    assert not env.step(action).truncated


@pytest.mark.parametrize("defect", ["one short", "flat", "scalar", "extra axis", "words"])
def test_actions_of_another_shape_are_refused(env: BatchEnv, defect: str) -> None:
    env.reset(0)
    good = np.zeros((NUM_ENVS, env.layout.action_dim))
    bad = {
        "one short": good[1:],
        "flat": good.ravel(),
        "scalar": np.float64(0.0),
        "extra axis": good[None],
        "words": np.full(good.shape, "up"),
    }[defect]
    with pytest.raises(ConfigurationError, match="action"):
        env.step(bad)
    env.step(good)  # the refusal did no harm


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_actions_that_are_not_finite_are_refused_by_position(env: BatchEnv, value: float) -> None:
    env.reset(0)
    action = np.zeros((NUM_ENVS, env.layout.action_dim))
    action[1, 0] = value
    with pytest.raises(ConfigurationError, match=r"action\[1, 0\]"):
        env.step(action)


@pytest.mark.parametrize("num_envs", [0, -1, 1.5, True])
def test_impossible_numbers_of_environments_are_refused(task: str, num_envs: int) -> None:
    with pytest.raises(ConfigurationError, match="num_envs"):
        tasks.make_batch(task, num_envs)


def test_impossible_numbers_of_threads_are_refused(task: str) -> None:
    with pytest.raises(ConfigurationError, match="num_threads"):
        tasks.make_batch(task, 1, num_threads=-1)


def test_layout_survives_json(task: str) -> None:
    layout = tasks.layout(task)
    assert PolicyLayout.from_json(layout.to_json()) == layout


def test_unknown_options_are_refused_with_those_that_exist(task: str) -> None:
    with pytest.raises(ConfigurationError, match=r"gravity.*options are .*seed"):
        tasks.make_batch(task, 1, gravity=0.0)
    with pytest.raises(ConfigurationError, match=r"gravity.*options are .*time_input"):
        tasks.layout(task, gravity=0.0)


def test_an_unknown_task_is_refused_with_those_that_exist() -> None:
    with pytest.raises(NotFoundError, match=r"door_oven.*open_press_close, door_open, point_maze"):
        tasks.make_batch("door_oven", 1)
    with pytest.raises(NotFoundError, match="door_oven"):
        tasks.layout("door_oven")


def test_the_suite_knows_every_task() -> None:
    assert set(RANDOMISED) == set(tasks.names())
