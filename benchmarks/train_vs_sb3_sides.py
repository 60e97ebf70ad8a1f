"""The sides of `train_vs_sb3.py`: ours, and settings of Stable-Baselines3's SAC with hindsight.

Each trains in the process that calls it, under the eyes of the judge.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import torch
from common import progress
from time_to_success import Judge, Look, Stopwatch, peak_memory_mib, share_of_successes

from skewmi.policy_io import Ball
from skewmi.sim import tasks

OURS = "ours"
TASK, PRESET = "point_maze", "improved-return-then-explore"
TARGET, RADIUS = (-8.0, 0.0), 0.15
"""m. The targets of the task have this radius; this one is the farthest from the start."""
START_NOISE = 0.12
"""Half-width of the starts, m: one step. Without any, all episodes of a policy are the same."""
EPISODES = 20
"""That a look at a policy takes, side by side."""
HIDDEN = (128, 128)
LOOK_EVERY = {OURS: 5_000, "peer": 1_000}
"""Environment steps between two looks: one round of our episodes, five episodes of the peer."""

_HER = {"n_sampled_goal": 4, "goal_selection_strategy": "future"}
_REACH: dict[str, Any] = {
    "buffer_size": 1_000_000,
    "ent_coef": "auto",
    "batch_size": 256,
    "gamma": 0.95,
    "learning_rate": 1e-3,
    "learning_starts": 1_000,
    "replay_buffer_kwargs": _HER,
}
PEERS: dict[str, dict[str, Any]] = {
    "fetch-reach": _REACH,
    "parking": {
        "buffer_size": 1_000_000,
        "batch_size": 512,
        "gamma": 0.98,
        "learning_rate": 1.5e-3,
        "tau": 0.005,
        "learning_starts": 1_000,
        "replay_buffer_kwargs": {"n_sampled_goal": 4, "goal_selection_strategy": "episode"},
    },
    "far": {**_REACH, "gamma": 0.99},
}
"""Arguments of the peer's SAC, by name. From rl-baselines3-zoo (DLR-RM, commit 22e3ff2):

- `fetch-reach`: `hyperparams/sac.yml`, FetchReach-v1, its only entry of SAC with hindsight. Instead
  of `normalize` (running moments, which a goal that never changes does not have) inputs are scaled
  by the ranges of the layout, as ours are.
- `parking`: `hyperparams/tqc.yml`, parking-v0, its only entry of a point in a plane. There it is
  for TQC, a relative of SAC, and learning starts earlier than an episode of ours ends.
- `far`: `fetch-reach` with the discount of our preset. The way to the target takes some 130 steps,
  after which the zoo's leaves a thousandth.

The zoo's networks are larger or smaller; here they are as ours.
"""


class PeerMaze(gymnasium.Wrapper):  # type: ignore[type-arg]
    """The maze as the peer sees it: its desired goal is the target, inputs are in [-1, 1].

    Rewards are -1, and 0 where the goal is reached, as in the tasks that the settings are of.
    """

    def __init__(self, start_noise: float = START_NOISE) -> None:
        options = {"time_input": True, "start_noise": start_noise}
        super().__init__(
            gymnasium.make(
                "skewmi.sim.gym_envs:skewmi/PointMaze-v0", **options, disable_env_checker=True
            )
        )
        fields = self.unwrapped.layout.observation  # type: ignore[attr-defined]
        low, high = np.array([f.low for f in fields]), np.array([f.high for f in fields])
        self._centre, self._half = 0.5 * (low + high), 0.5 * (high - low)
        self.observation_space = gymnasium.spaces.Dict(
            {
                name: gymnasium.spaces.Box(-2.0, 2.0, space.shape, np.float32)
                for name, space in self.env.observation_space.items()  # type: ignore[attr-defined]
            }
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        observation, info = self.env.reset(seed=seed, options={"desired_goal": TARGET})
        return self.scaled(observation), info

    def step(self, action: Any) -> Any:
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self.scaled(observation), float(reward) - 1.0, terminated, truncated, info

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        achieved, desired = (
            np.asarray(goal, np.float64) * self._half[:2] + self._centre[:2]
            for goal in (achieved_goal, desired_goal)
        )
        maze: Any = self.unwrapped
        return maze.compute_reward(achieved, desired, info) - 1.0

    def scaled(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Entries begin with x and y; shape (..., 2 or 3)."""
        result = {}
        for name, value in observation.items():
            k = value.shape[-1]
            result[name] = ((value - self._centre[:k]) / self._half[:k]).astype(np.float32)
        return result


def maze(num_envs: int, seed: int) -> Any:
    """Copies of the maze whose region is around the target."""
    env: Any = tasks.make_batch(
        TASK, num_envs, num_threads=1, seed=seed, time_input=True, start_noise=START_NOISE
    )
    env.layout = replace(env.layout, reward_region=(Ball(("x", "y"), TARGET, RADIUS),))
    return env


def train(
    side: str, seed: int, *, limit_s: float | None, steps: int | None, bar: float, in_a_row: int
) -> dict[str, Any]:
    """Train a side until it is judged to be done, or given up; its row.

    Args:
        side: `ours`, or one of `PEERS`.
        seed: Of everything random in the training.
        limit_s: Wall-clock seconds of training, or None.
        steps: Budget of environment steps of ours; None: the preset's.
        bar, in_a_row: See `Judge`.
    """
    torch.set_num_threads(1)
    observers = maze(EPISODES, 0)

    def judge_of(present: Callable[[], Act], watch: Stopwatch) -> Judge:
        def look() -> float:
            return share_of_successes(present(), observers, TARGET, RADIUS, seed=10_000)

        return Judge(look, watch, bar=bar, in_a_row=in_a_row, limit_s=limit_s, say=_tell)

    if side == OURS:
        judge, updates = _train_ours(seed, steps, judge_of)
    else:
        judge, updates = _train_peer(PEERS[side], seed, judge_of)
    at = judge.solved or judge.curve[-1]
    return {
        "side": side,
        "seed": seed,
        "solved": judge.solved is not None,
        "steps": at[0],
        "wall_s": at[1],
        "processor_s": at[2],
        "updates_in_all": updates,
        "limit_s": limit_s,
        "peak_memory_mib": peak_memory_mib(),
        "curve": judge.curve,
        "finished_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }


def _tell(look: Look) -> None:
    steps, wall, _, share = look
    progress(f"  {wall:7.1f} s, {steps:9,} steps: {share:4.0%} of the episodes succeed")


Act = Callable[[np.ndarray], np.ndarray]
"""Observations to actions."""
JudgeOf = Callable[[Callable[[], Act], Stopwatch], Judge]
"""Makes the judge, from what gives the present policy and the clock of the training."""


def _train_ours(seed: int, steps: int | None, judge_of: JudgeOf) -> tuple[Judge, int]:
    from skewmi.cli.train_options import starting_config
    from skewmi.train.memory import keep_freed_memory
    from skewmi.train.policy import TorchPolicy
    from skewmi.train.runner import Runner

    keep_freed_memory()
    config = replace(starting_config(TASK, PRESET), seed=seed)
    assert getattr(config.learner, "hidden", None) == HIDDEN
    watch = Stopwatch()
    env = maze(config.rollout.num_envs, seed)
    runner = Runner(config, env)

    def present() -> Act:
        goal = runner.exploration.evaluation_goal
        return TorchPolicy(env.layout, runner.learner.policy_module(goal), goal, {}).act

    judge, seen = judge_of(present, watch), 0
    while runner.steps < (steps or config.total_steps):
        runner.iterate()
        if runner.steps >= seen + LOOK_EVERY[OURS]:
            seen = runner.steps
            if judge.over(runner.steps):
                break
    return judge, runner.learner.updates


def _train_peer(arguments: dict[str, Any], seed: int, judge_of: JudgeOf) -> tuple[Judge, int]:
    from stable_baselines3 import SAC, HerReplayBuffer
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.logger import Logger

    watch = Stopwatch()
    env = PeerMaze()
    model = SAC(
        "MultiInputPolicy", env, replay_buffer_class=HerReplayBuffer, device="cpu", seed=seed,
        policy_kwargs={"net_arch": list(HIDDEN)}, **arguments,
    )  # fmt: skip
    model.set_logger(Logger(None, []))  # its own makes a folder every time, and leaves it

    def act(observation: np.ndarray) -> np.ndarray:
        place = observation[:, :2]
        goal = np.broadcast_to(TARGET, place.shape)
        whole = {"observation": observation, "achieved_goal": place, "desired_goal": goal}
        return model.predict(env.scaled(whole), deterministic=True)[0]

    judge = judge_of(lambda: act, watch)

    class Looks(BaseCallback):
        def _on_step(self) -> bool:
            due = self.num_timesteps % LOOK_EVERY["peer"] == 0
            return not (due and judge.over(self.num_timesteps))

    model.learn(10**12, callback=Looks())
    return judge, model._n_updates
