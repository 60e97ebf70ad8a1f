"""A tiny task for learner tests: a point in a small corridor, a few lines of arithmetic."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from skewmi.batch_env import Condition, Event, GridAxis, StepResult, TaskMetrics
from skewmi.policy_io import ActionField, Array, Ball, Field, PolicyLayout
from skewmi.success import inside_region
from skewmi.train.config import MetricsConfig, RolloutConfig, TrainConfig
from skewmi.train.exploration.skew_explore import SkewExploreConfig
from skewmi.train.replay import Episodes, Replay
from skewmi.train.sac.config import SacConfig

STEPS = 40

# Networks this small only lose by threads, and lose badly when tests run side by side.
torch.set_num_threads(1)


class Corridor:
    """A point in a U: x in [0, 4], y in [0, 4], a wall at x in (1.6, 2.4) below y = 3.

    Steps of at most 0.25 per axis; a step into a wall is undone. Satisfies `BatchEnv`.
    """

    def __init__(self, num_envs: int = 5, field_high: float = 4.0) -> None:
        self.num_envs = num_envs
        self.layout = PolicyLayout(
            task="corridor",
            observation=(
                Field("x", "m", "world", 0.0, field_high),
                Field("y", "m", "world", 0.0, 4.0),
                Field("time", "1", "episode", 0.0, 1.0),
            ),
            action=(
                ActionField("step_x", "m/step", "world", 0.25),
                ActionField("step_y", "m/step", "world", 0.25),
            ),
            reward_region=(Ball(("x", "y"), (3.5, 0.5), 0.45),),
            control_dt=0.1,
            episode_steps=STEPS,
            success_hold_steps=5,
        )
        self.generator = np.random.default_rng(0)
        self.position = np.zeros((num_envs, 2))
        self.t = 0

    def reset(self, seed: int | None = None) -> Array:
        if seed is not None:
            self.generator = np.random.default_rng(seed)
        self.position = 0.5 + self.generator.uniform(-0.05, 0.05, (self.num_envs, 2))
        self.t = 0
        return self._observe()

    def step(self, action: Array) -> StepResult:
        moved = self.position + 0.25 * np.clip(action, -1.0, 1.0)
        free = self.reachable(moved)
        self.position = np.where(free[:, None], moved, self.position)
        self.t += 1
        reward = self.compute_reward(self.position)
        return StepResult(self._observe(), reward, reward > 0.0, self.t == STEPS)

    def _observe(self) -> Array:
        time = np.full((self.num_envs, 1), self.t / STEPS)
        return np.concatenate((self.position, time), axis=1)

    def compute_reward(self, state: Array) -> Array:
        return inside_region(self.layout, state).astype(np.float64)

    def reachable(self, state: Array) -> np.ndarray:
        x, y = state[..., 0], state[..., 1]
        inside = (x >= 0.0) & (x <= 4.0) & (y >= 0.0) & (y <= 4.0)
        return inside & ~((x > 1.6) & (x < 2.4) & (y < 3.0))

    def random_state(self) -> dict[str, object]:
        return {"generator": self.generator.bit_generator.state}

    def set_random_state(self, state: dict[str, object]) -> None:
        self.generator.bit_generator.state = state["generator"]


@pytest.fixture
def make_corridor() -> Callable[..., Corridor]:
    return Corridor


@pytest.fixture
def corridor_config() -> TrainConfig:
    """Small enough to iterate in a tenth of a second, with every ingredient switched on."""
    return TrainConfig(
        task="corridor",
        seed=3,
        total_steps=1200,
        learner=SacConfig(hidden=(32, 32), batch_size=64, updates_per_step=0.05),
        exploration=SkewExploreConfig(
            sigma=0.5,
            running_scale=True,
            history_points=200,
            candidates=300,
            proposals=20,
            refresh_steps=200,
            first_refresh_steps=200,
            field_weights=(("y", 1.5),),
        ),
        rollout=RolloutConfig(
            num_envs=5, random_steps=200, evaluation_envs=1, history_steps=20 * STEPS
        ),
        metrics=MetricsConfig(entropy_bandwidth=0.2, entropy_points=300, every_steps=400),
        task_metrics=TaskMetrics(
            grid=(GridAxis("x", 0.0, 4.0, 10), GridAxis("y", 0.0, 4.0, 10)),
            events=(Event("right side", (Condition("x", low=2.4),)),),
        ),
    )


def random_episodes(
    layout: PolicyLayout, n: int, rng: np.random.Generator, paid: float = 0.1
) -> Episodes:
    """Episodes of the corridor, made up at random; a fraction `paid` of the steps is rewarded."""
    steps = layout.episode_steps
    observations = rng.uniform(0, 4, size=(n, steps + 1, 3))
    observations[..., 2] = np.arange(steps + 1) / steps
    return Episodes(
        observations=observations,
        actions=rng.uniform(-1, 1, size=(n, steps, 2)),
        goals=rng.uniform(0, 4, size=(n, steps, 2)),
        rewards=(rng.random((n, steps)) < paid).astype(float),
    )


@pytest.fixture
def make_episodes() -> Callable[..., Episodes]:
    return random_episodes


@pytest.fixture
def layout() -> PolicyLayout:
    return Corridor().layout


@pytest.fixture
def filled(layout: PolicyLayout) -> tuple[Replay, Episodes, Array]:
    """A history of eight episodes, the episodes, and their trajectory terms."""
    rng = np.random.default_rng(0)
    history = Replay(layout, 12 * layout.episode_steps, 2)
    episodes = random_episodes(layout, 8, rng)
    term = rng.normal(size=(8, layout.episode_steps))
    history.add(episodes, term)
    return history, episodes, term
