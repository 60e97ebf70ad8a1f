"""A task that nobody without a memory can do, in a few lines of arithmetic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skewmi.batch_env import StepResult
from skewmi.policy_io import ActionField, Array, Ball, Field, PolicyLayout
from skewmi.train.exploration.protocol import ExplorationConfig
from skewmi.train.replay import Episodes, Index, Replay
from skewmi.train.state import State

STEPS = 8
ASKED = 4
"""The last so many steps are paid; before them nothing depends on the action."""


class Recall:
    """A cue of -1 or +1 at the first step, nothing afterwards; the answer is its sign.

    Satisfies `BatchEnv`. An observation from the second step on says the time only, so without a
    memory no policy gets more than half of the answers right, on average.
    """

    def __init__(self, num_envs: int) -> None:
        self.num_envs = num_envs
        self.layout = PolicyLayout(
            task="recall",
            observation=(
                Field("cue", "1", "episode", -1.0, 1.0),
                Field("time", "1", "episode", 0.0, 1.0),
            ),
            action=(ActionField("answer", "1", "episode", 1.0),),
            reward_region=(Ball(("cue",), (0.0,), 0.5),),
            control_dt=0.1,
            episode_steps=STEPS,
            success_hold_steps=1,
        )
        self.generator = np.random.default_rng(0)
        self.cue = np.ones(num_envs)
        self.t = 0

    def reset(self, seed: int | None = None) -> Array:
        if seed is not None:
            self.generator = np.random.default_rng(seed)
        self.cue = self.generator.choice([-1.0, 1.0], size=self.num_envs)
        self.t = 0
        return self._observe()

    def step(self, action: Array) -> StepResult:
        right = action[:, 0] * self.cue > 0.0
        self.t += 1
        asked = self.t > STEPS - ASKED
        reward = (right & asked).astype(np.float64)
        return StepResult(self._observe(), reward, reward > 0.0, self.t == STEPS)

    def _observe(self) -> Array:
        shown = self.cue if self.t == 0 else np.zeros(self.num_envs)
        return np.stack((shown, np.full(self.num_envs, self.t / STEPS)), axis=1)

    def compute_reward(self, state: Array) -> Array:
        return np.zeros(state.shape[:-1])

    def reachable(self, state: Array) -> NDArray[np.bool_]:
        return np.ones(state.shape[:-1], dtype=np.bool_)

    def random_state(self) -> dict[str, object]:
        return {"generator": self.generator.bit_generator.state}

    def set_random_state(self, state: dict[str, object]) -> None:
        self.generator.bit_generator.state = state["generator"]


@dataclass(frozen=True)
class NothingConfig(ExplorationConfig):
    """No goals, no bonus."""


class Nothing:
    """Satisfies `Exploration`: the task's own reward is all there is."""

    goal_dim = 0
    moves_at_random = False
    extrinsic_weight = 1.0
    metrics = ()
    refreshes = 0

    def __init__(
        self, config: NothingConfig, layout: PolicyLayout, generator: np.random.Generator
    ) -> None:
        self.evaluation_goal: Array = np.zeros(0)
        self.proposals: Array = np.zeros((0, 0))
        self.proposal_episodes: Index = np.zeros(0, dtype=np.int64)
        self.episodes = 0

    def begin(self, episodes: int, evaluation: int, generator: np.random.Generator) -> None:
        self.episodes = episodes

    def goals(self, step: int, observations: Array) -> Array:
        return np.zeros((self.episodes, 0))

    def wandering(self) -> None:
        return None

    def observe(self, episodes: Episodes) -> Array:
        return np.zeros(episodes.rewards.shape)

    def intrinsic_reward(
        self,
        states: NDArray[np.floating],
        goals: NDArray[np.floating],
        trajectory_term: NDArray[np.floating],
    ) -> Array:
        return np.zeros(states.shape[:-1])

    def refresh(
        self, history: Replay, steps: int, generator: np.random.Generator
    ) -> dict[str, float]:
        return {}

    def state_dict(self) -> State:
        return {}

    def load_state_dict(self, state: State) -> None:
        pass
