"""The whole contract between a learner and an environment.

It stands beside `policy_io` because `sim` implements it and `train` uses it, and neither may
import the other. Needs numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array, PolicyLayout


@dataclass(frozen=True)
class StepResult:
    """What one step of all environments gives. Every array has its own memory.

    Attributes:
        observation: After the step, layout order and units. Shape (num_envs, observation_dim).
        reward: Extrinsic, 1.0 inside the reward region, else 0.0. Shape (num_envs,).
        success: Whether the region was inside at this step. Shape (num_envs,).
        truncated: Whether this was the episode's last step (the same for all environments).
    """

    observation: Array
    reward: Array
    success: NDArray[np.bool_]
    truncated: bool


class BatchEnv(Protocol):
    """`num_envs` copies of one task, stepped in lock-step through episodes of fixed length.

    Nothing terminates early, so all copies start and end together: `reset`, then
    `layout.episode_steps` times `step`. There is no automatic reset.
    """

    num_envs: int
    layout: PolicyLayout

    def reset(self, seed: int | None = None) -> Array:
        """Start new episodes everywhere; with a seed, restart the random streams from it.

        Returns the first observation, shape (num_envs, observation_dim).
        """

    def step(self, action: Array) -> StepResult:
        """Apply actions in [-1, 1], shape (num_envs, action_dim)."""

    def compute_reward(self, state: Array) -> Array:
        """Extrinsic reward of states, vectorised. Shape (..., state_dim) -> (...)."""

    def reachable(self, state: Array) -> NDArray[np.bool_]:
        """Whether states can be reached at all. Shape (..., state_dim) -> (...)."""

    def random_state(self) -> dict[str, object]:
        """JSON-serialisable state of every random stream, for checkpoints."""

    def set_random_state(self, state: dict[str, object]) -> None:
        """Inverse of `random_state`."""
