"""The Gymnasium faces: Gymnasium's own checks, and goals."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.errors import ConfigurationError
from skewmi.policy_io import Ball, PolicyLayout
from skewmi.sim import gym_envs, tasks
from skewmi.sim.goals import RegionGoals
from skewmi.success import inside_region

IDS = tuple(gym_envs.IDS)
MAZE = "skewmi/PointMaze-v0"
UNBOUNDED = "A Box observation space m"
"""Start of Gymnasium's two warnings about infinite bounds: our ranges scale, they do not clip."""


@pytest.fixture(params=IDS)
def env_id(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


def equal(first: Any, second: Any) -> None:
    assert first.keys() == second.keys()
    for name in first:
        np.testing.assert_array_equal(first[name], second[name])


def test_every_task_is_registered() -> None:
    assert set(gym_envs.IDS.values()) == set(tasks.names())
    gym_envs.register()  # again, without complaint
    for name in IDS:
        assert gymnasium.spec(name).vector_entry_point is not None


def test_gymnasium_finds_nothing_wrong(env_id: str) -> None:
    env = gymnasium.make(env_id, time_input=True)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env.unwrapped, skip_render_check=True)
    assert [str(w.message) for w in caught if UNBOUNDED not in str(w.message)] == []
    env.close()


def test_gymnasium_can_render(env_id: str) -> None:
    env = gymnasium.make(env_id, render_mode="rgb_array", width=96, height=64)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env.unwrapped)
    assert [str(w.message) for w in caught if UNBOUNDED not in str(w.message)] == []
    env.reset(seed=0)
    first = np.asarray(env.render())
    for _ in range(8):
        env.step(np.ones(env.action_space.shape, dtype=np.float32))
    second = np.asarray(env.render())
    env.close()
    assert first.shape == (64, 96, 3)
    assert first.dtype == np.uint8
    assert first.std() > 5.0
    assert (first != second).any()


def test_single_environment_is_the_batched_one(env_id: str) -> None:
    env = gymnasium.make(env_id)
    batch = tasks.make_batch(gym_envs.IDS[env_id], 1, num_threads=1)
    observation, info = env.reset(seed=4)
    assert info == {}
    np.testing.assert_array_equal(observation["observation"], batch.reset(4)[0])
    env.action_space.seed(0)
    for _ in range(5):
        action = env.action_space.sample()
        observation, reward, terminated, truncated, info = env.step(action)
        expected = batch.step(action[None])
        np.testing.assert_array_equal(observation["observation"], expected.observation[0])
        assert reward == expected.reward[0]
        assert (terminated, truncated) == (False, expected.truncated)
        assert info == {"success": expected.success[0], "is_success": expected.success[0]}
    env.close()


def test_episodes_are_truncated_and_never_terminate() -> None:
    env = gymnasium.make(MAZE)
    env.reset(seed=0)
    ends = [env.step(np.zeros(2, dtype=np.float32))[2:4] for _ in range(200)]
    assert ends == [(False, False)] * 199 + [(False, True)]


def test_unseeded_environments_start_differently() -> None:
    starts = [gymnasium.make(MAZE, start_noise=0.5).reset()[0]["observation"] for _ in range(2)]
    assert (starts[0] != starts[1]).all()


def test_reward_of_a_step_is_compute_reward_of_its_goals() -> None:
    # The goal is next to the start, so that the point comes and goes.
    env: Any = gymnasium.make(MAZE).unwrapped
    observation, _ = env.reset(seed=0, options={"desired_goal": [0.3, 0.0]})
    rewards = []
    for action in [1.0] * 6 + [-1.0] * 6:
        observation, reward, _, _, info = env.step(np.array([action, 0.0], dtype=np.float32))
        assert reward == env.compute_reward(
            observation["achieved_goal"], observation["desired_goal"], info
        )
        assert info["is_success"] == (reward == 1.0)
        assert not info["success"]  # the task's own region is far away
        rewards.append(reward)
    assert rewards == [0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]
    observation, _ = env.reset()
    assert observation["desired_goal"].tolist() == [-4.0, 0.0]


def test_goals_and_rewards_are_of_what_the_sensors_say() -> None:
    name = "skewmi/OpenPressClose-v0"
    biased = tasks.find("open_press_close").variations.parse("sensors: {lid_bias_deg: 20}")
    env: Any = gymnasium.make(name, variation=biased).unwrapped
    ideal: Any = gymnasium.make(name).unwrapped
    true_goal = ideal.reset(seed=0)[0]["achieved_goal"]
    measured = env.reset(seed=0)[0]["achieved_goal"]
    lid = env.goal_names.index("lid_angle")
    assert measured[lid] - true_goal[lid] == pytest.approx(np.radians(20.0))
    still = np.zeros(env.action_space.shape, dtype=np.float32)
    for goal, expected in ((measured, 1.0), (true_goal, 0.0)):
        env.reset(seed=0, options={"desired_goal": goal})
        observation, reward, _, _, info = env.step(still)
        assert reward == expected
        assert info["is_success"] == (reward == 1.0)
        assert reward == env.compute_reward(
            observation["achieved_goal"], observation["desired_goal"], info
        )


def test_goal_and_observation_name_their_fields() -> None:
    env: Any = gymnasium.make(MAZE, time_input=True).unwrapped
    assert env.goal_names == ("x", "y")
    assert env.layout.observation_names == ("x", "y", "time")
    observation, _ = env.reset(seed=0)
    assert {k: v.shape for k, v in observation.items()} == {
        "observation": (3,),
        "achieved_goal": (2,),
        "desired_goal": (2,),
    }


@pytest.mark.parametrize("task", tasks.names())
@settings(max_examples=50)
@given(seed=st.integers(0, 2**32))
def test_default_goal_is_the_reward_region(task: str, seed: int) -> None:
    layout = tasks.layout(task)
    goals = RegionGoals(layout)
    generator = np.random.default_rng(seed)
    state = generator.uniform(
        layout.observation_low, layout.observation_high, (200, layout.state_dim)
    )
    # Half of them around the region, where the answer is not plainly no.
    columns = [layout.observation_names.index(name) for name in goals.names]
    radii = {name: ball.radius for ball in layout.reward_region for name in ball.fields}
    spread = 1.5 * np.array([radii[name] for name in goals.names])
    state[:100, columns] = goals.default + generator.uniform(-spread, spread, (100, goals.dim))
    reached = goals.reached(goals.achieved(state), goals.default)
    np.testing.assert_array_equal(reached, inside_region(layout, state))


@given(
    goal=st.tuples(st.floats(-12, 4), st.floats(-6, 6)),
    offset=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
)
def test_a_goal_moves_the_region_with_it(
    goal: tuple[float, float], offset: tuple[float, float]
) -> None:
    distance = float(np.hypot(*offset))
    if abs(distance - 0.15) < 1e-9:
        return
    achieved = np.array(goal) + offset
    assert RegionGoals(tasks.layout("point_maze")).reached(achieved, goal) == (distance < 0.15)


def test_goals_cover_only_the_fields_of_the_region_and_are_vectorised() -> None:
    layout = tasks.layout("point_maze")
    content = {**vars(layout), "reward_region": (Ball(("y",), (1.0,), 0.5),)}
    goals = RegionGoals(PolicyLayout(**content))
    assert (goals.names, goals.dim, goals.default.tolist()) == (("y",), 1, [1.0])
    achieved = np.arange(12.0).reshape(3, 4, 1)
    reached = goals.reached(achieved, np.array([5.0]))
    assert reached.shape == (3, 4)
    assert np.argwhere(reached).tolist() == [[1, 1]]
    with pytest.raises(ConfigurationError, match="1 entries"):
        goals.reached(np.zeros((3, 2)), np.zeros(1))
    with pytest.raises(ConfigurationError, match="no reward region"):
        RegionGoals(PolicyLayout(**{**content, "reward_region": ()}))


@pytest.mark.parametrize("goal", [[1.0], [[0.0, 0.0]] * 3, [np.nan, 0.0], "here"])
def test_impossible_goals_are_refused(goal: Any) -> None:
    envs = gymnasium.make_vec(MAZE, num_envs=2)
    with pytest.raises(ConfigurationError, match="desired_goal"):
        envs.reset(options={"desired_goal": goal})


def test_unknown_options_and_modes_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="colour"):
        gymnasium.make(MAZE).reset(options={"colour": 1})
    with pytest.raises(ConfigurationError, match="gravity"):
        gymnasium.make(MAZE, gravity=1)
    with pytest.raises(ConfigurationError, match="SameStep"):
        gymnasium.make_vec(MAZE, autoreset_mode="Sometimes")
    with pytest.raises(ConfigurationError, match="rgb_array"):
        gym_envs.GoalEnv("point_maze", render_mode="human")
