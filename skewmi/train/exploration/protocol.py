"""What runner and learners ask of an exploration. `registry.EXPLORATIONS` has one line for each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array
from skewmi.train.checks import require_finite
from skewmi.train.replay import Episodes, Index, Replay
from skewmi.train.state import State


@dataclass(frozen=True)
class ExplorationConfig:
    """The numbers of an exploration; each exploration derives its own."""

    def __post_init__(self) -> None:
        require_finite(self)


class Exploration(Protocol):
    """Says where to go next, and what being there is worth.

    The reward that a learner maximises, at a state s on the way to a goal z, is

        intrinsic_reward(s, z, trajectory term of s) + extrinsic_weight * r_ext(s)

    Goals are states of the task (goal_dim = state_dim), or there are none (goal_dim = 0) and only
    the intrinsic reward drives. What of that reward depends on the trajectory but not on the goal
    is computed once, when an episode ends, and stored with it, so that any state can be given any
    goal later. An exploration constructs itself from its configuration, the layout of the task and
    the run's random generator.
    """

    @property
    def goal_dim(self) -> int:
        """Size of a goal: state_dim, or 0 if there are none."""

    @property
    def extrinsic_weight(self) -> float:
        """Of the task's reward of 1 per step."""

    @property
    def moves_at_random(self) -> bool:
        """Whether `wandering` ever names an episode: on-policy learners cannot use that."""

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of what `refresh` returns, in the order of their columns."""

    @property
    def refreshes(self) -> int:
        """How often what drives exploration was renewed so far: goals, or what stands for them."""

    @property
    def evaluation_goal(self) -> Array:
        """What deterministic episodes and exported policies aim at. Shape (goal_dim,)."""

    @property
    def proposals(self) -> Array:
        """Present goals, for hindsight. Shape (k, goal_dim)."""

    @property
    def proposal_episodes(self) -> Index:
        """Slots of the episodes in which the proposals were met. Shape (k,), or (0,)."""

    def begin(self, episodes: int, evaluation: int, generator: np.random.Generator) -> None:
        """Episodes start, side by side.

        Args:
            episodes: How many.
            evaluation: The first so many tell whether the task is learned: the first keeps the
                evaluation goal, the others rewarded states once there are any, each its own.
            generator: Of the random choices.
        """

    def goals(self, step: int, observations: Array) -> Array:
        """Goals of the next step.

        Args:
            step: 0 to episode_steps - 1.
            observations: Before it. Shape (episodes, observation_dim).

        Returns:
            Shape (episodes, goal_dim).
        """

    def wandering(self) -> NDArray[np.bool_] | None:
        """Which episodes move at random in the step whose goals were asked for last.

        Returns:
            Shape (episodes,); None if none of them ever does.
        """

    def observe(self, episodes: Episodes) -> Array:
        """Take in finished episodes.

        Returns:
            The trajectory term of every state they reached. Shape (episodes, steps).
        """

    def intrinsic_reward(
        self,
        states: NDArray[np.floating],
        goals: NDArray[np.floating],
        trajectory_term: NDArray[np.floating],
    ) -> Array:
        """Weighted intrinsic reward of being in states.

        Args:
            states: Reached. Shape (..., state_dim).
            goals: Broadcasting with the states' leading axes. Shape (..., goal_dim).
            trajectory_term: As stored. Shape (...).

        Returns:
            Shape (...).
        """

    def refresh(
        self, history: Replay, steps: int, generator: np.random.Generator
    ) -> dict[str, float]:
        """Renew what is due after an iteration: goals, densities, networks.

        Args:
            history: All episodes.
            steps: Environment steps so far.
            generator: Of the random choices.

        Returns:
            Some of `metrics`.
        """

    def state_dict(self) -> State:
        """All that an identical continuation needs."""

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`.

        Raises:
            KeyError, ValueError, TypeError: It is damaged.
        """


def total_reward(
    exploration: Exploration,
    states: NDArray[np.floating],
    goals: NDArray[np.floating],
    trajectory_term: NDArray[np.floating],
    extrinsic: NDArray[np.floating],
) -> Array:
    """What a learner maximises, see `Exploration`; shapes as there, extrinsic (...)."""
    intrinsic = exploration.intrinsic_reward(states, goals, trajectory_term)
    reward: Array = intrinsic + exploration.extrinsic_weight * extrinsic
    return reward
