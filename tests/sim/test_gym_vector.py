"""The Gymnasium vector environments, and other people's SAC on ours."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from skewmi.errors import ConfigurationError
from skewmi.sim import gym_envs, tasks

IDS = tuple(gym_envs.IDS)


MAZE = "skewmi/PointMaze-v0"


@pytest.fixture(params=IDS)
def env_id(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


def equal(first: Any, second: Any) -> None:
    assert first.keys() == second.keys()
    for name in first:
        np.testing.assert_array_equal(first[name], second[name])


def test_vector_environment_is_the_batched_one(env_id: str) -> None:
    envs = gymnasium.make_vec(env_id, num_envs=3, num_threads=1)
    batch = tasks.make_batch(gym_envs.IDS[env_id], 3, num_threads=1)
    observation, _ = envs.reset(seed=9)
    np.testing.assert_array_equal(observation["observation"], batch.reset(9))
    assert observation in envs.observation_space
    envs.action_space.seed(0)
    for _ in range(3):
        actions = envs.action_space.sample()
        observation, reward, terminated, truncated, info = envs.step(actions)
        expected = batch.step(actions)
        np.testing.assert_array_equal(observation["observation"], expected.observation)
        np.testing.assert_array_equal(reward, expected.reward)
        np.testing.assert_array_equal(info["success"], expected.success)
        assert not terminated.any()
        assert not truncated.any()
    envs.close()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_automatic_reset_is_that_of_gymnasium(mode: AutoresetMode) -> None:
    # The maze without noise needs no random numbers, so both must agree in everything.
    ours = gymnasium.make_vec(MAZE, num_envs=2, autoreset_mode=mode)
    theirs = gymnasium.make_vec(
        MAZE, num_envs=2, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}
    )
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"] == mode
    equal(ours.reset(seed=0)[0], theirs.reset(seed=0)[0])
    ours.action_space.seed(0)
    for _ in range(410):
        actions = ours.action_space.sample()
        results = ours.step(actions), theirs.step(actions)
        equal(results[0][0], results[1][0])
        for mine, reference in zip(results[0][1:4], results[1][1:4], strict=True):
            np.testing.assert_array_equal(mine, reference)
            assert mine.dtype == reference.dtype
        assert results[0][4].keys() == results[1][4].keys()
        for key in results[0][4]:
            mine, reference = results[0][4][key], results[1][4][key]
            if key == "final_obs":
                for a, b in zip(mine, reference, strict=True):
                    equal(a, b)
            elif key == "final_info":
                equal(mine, reference)
            else:
                np.testing.assert_array_equal(mine, reference)


def test_without_automatic_reset_the_caller_resets() -> None:
    envs = gymnasium.make_vec(MAZE, num_envs=2, autoreset_mode="Disabled")
    envs.reset(seed=0)
    for _ in range(200):
        *_, truncated, _ = envs.step(np.zeros((2, 2), dtype=np.float32))
    assert truncated.all()
    with pytest.raises(ConfigurationError, match="reset"):
        envs.step(np.zeros((2, 2), dtype=np.float32))
    # As Gymnasium's own vector environments: those that ended are named, here always all.
    options = {"reset_mask": truncated, "desired_goal": [0.3, 0.0]}
    observation, _ = envs.reset(options=options)
    assert set(options) == {"reset_mask", "desired_goal"}
    np.testing.assert_array_equal(observation["desired_goal"], [[0.3, 0.0]] * 2)
    envs.step(np.zeros((2, 2), dtype=np.float32))


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        (np.array([True, False]), "1 of 2 copies"),
        (np.array([True]), "shape"),
        (np.array([1, 1]), "bool"),
    ],
)
def test_a_reset_mask_that_cannot_be_followed_is_refused(mask: Any, message: str) -> None:
    envs = gymnasium.make_vec(MAZE, num_envs=2, autoreset_mode="Disabled")
    with pytest.raises(ConfigurationError, match=message):
        envs.reset(options={"reset_mask": mask})


def test_each_copy_can_have_its_own_goal() -> None:
    envs: Any = gymnasium.make_vec(MAZE, num_envs=2)
    envs.reset(seed=0, options={"desired_goal": [[0.0, 0.0], [5.0, 5.0]]})
    observation, reward, _, _, info = envs.step(np.zeros((2, 2), dtype=np.float32))
    assert reward.tolist() == [1.0, 0.0]
    assert info["is_success"].tolist() == [True, False]
    again = envs.compute_reward(observation["achieved_goal"], observation["desired_goal"], info)
    np.testing.assert_array_equal(again, reward)


def test_gymnasium_wrappers_work_on_the_vector_environment() -> None:
    envs = gymnasium.wrappers.vector.RecordEpisodeStatistics(gymnasium.make_vec(MAZE, num_envs=2))
    envs.reset(seed=0, options={"desired_goal": [0.0, 0.0]})
    for _ in range(200):
        *_, info = envs.step(np.zeros((2, 2), dtype=np.float32))
    np.testing.assert_array_equal(info["episode"]["r"], [200.0, 200.0])
    np.testing.assert_array_equal(info["episode"]["l"], [200, 200])


def train_with_stable_baselines(env_id: str, steps: int) -> Any:
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    import torch
    from stable_baselines3.common.env_checker import check_env as check_for_sb3

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        env = gymnasium.make(env_id)
        check_for_sb3(env.unwrapped)
        model = stable_baselines3.SAC(
            "MultiInputPolicy",
            env,
            replay_buffer_class=stable_baselines3.HerReplayBuffer,
            replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
            learning_starts=250,
            batch_size=64,
            policy_kwargs={"net_arch": [32, 32]},
            buffer_size=5000,
            seed=0,
            device="cpu",
        )
        model.learn(steps)
    finally:
        torch.set_num_threads(threads)
    return model


def check_hindsight_pays(model: Any) -> None:
    sample = model.replay_buffer.sample(512)
    # Real goals are far away, so every reward in there comes from our compute_reward through HER.
    assert 0.0 < sample.rewards.mean() < 1.0
    reached = model.env.env_method(
        "compute_reward",
        sample.next_observations["achieved_goal"].numpy(),
        sample.observations["desired_goal"].numpy(),
        {},
        indices=[0],
    )[0]
    np.testing.assert_array_equal(sample.rewards.numpy()[:, 0], reached)


def test_stable_baselines_trains_untouched(env_id: str) -> None:
    model = train_with_stable_baselines(env_id, 320)
    assert model.num_timesteps == 320
    check_hindsight_pays(model)


@pytest.mark.slow
def test_stable_baselines_trains_for_a_while(env_id: str) -> None:
    model = train_with_stable_baselines(env_id, 2000)
    assert model.num_timesteps == 2000
    check_hindsight_pays(model)
    observation, _ = model.env.envs[0].reset(seed=0)
    action, _ = model.predict(observation, deterministic=True)
    assert np.abs(action).max() <= 1.0
