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


@dataclass(frozen=True)
class GridAxis:
    """One axis of the grid that entropy and coverage are measured on."""

    field: str
    low: float
    high: float
    points: int


@dataclass(frozen=True)
class Condition:
    """A field inside a closed interval; None leaves that side open."""

    field: str
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Event:
    """Something whose first time is worth logging: all conditions at one step."""

    name: str
    conditions: tuple[Condition, ...]


@dataclass(frozen=True)
class TaskMetrics:
    """What is worth measuring in a task besides its reward.

    Attributes:
        grid: Axes on which entropy and coverage are measured; empty: neither is.
        unit_range: Whether each axis is scaled to [0, 1] before densities and distances, because
            its fields have different units.
        events: First times to log; the first reward always is.
    """

    grid: tuple[GridAxis, ...] = ()
    unit_range: bool = False
    events: tuple[Event, ...] = ()


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
