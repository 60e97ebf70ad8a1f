"""What explorations have in common whose goals come from a skewed density of visited states."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.exploration.goals import SkewedGoals, SkewedGoalsConfig
from skewmi.train.replay import Episodes, Index, Replay
from skewmi.train.state import State


class GoalExploration:
    """Satisfies `Exploration` but for what being somewhere is worth.

    Whoever derives from it adds `extrinsic_weight` and `intrinsic_reward`, and `trajectory_term`
    if its reward depends on the trajectory.
    """

    metrics: tuple[str, ...] = ()
    moves_at_random: bool = False

    def __init__(
        self, config: SkewedGoalsConfig, layout: PolicyLayout, generator: np.random.Generator
    ) -> None:
        self.skewed = SkewedGoals(config, layout, generator)
        self.goal_dim = layout.state_dim

    @property
    def refreshes(self) -> int:
        """How often goals were proposed."""
        return self.skewed.refreshes

    @property
    def evaluation_goal(self) -> Array:
        """Shape (state_dim,)."""
        return self.skewed.evaluation_goal

    @property
    def proposals(self) -> Array:
        """Shape (k, state_dim)."""
        return self.skewed.proposals

    @property
    def proposal_episodes(self) -> Index:
        """Shape (k,), or (0,) if goals are samples of a density."""
        return self.skewed.proposal_episodes

    def begin(self, episodes: int, evaluation: int, generator: np.random.Generator) -> None:
        """Choose the goals of the next episodes."""
        self.skewed.begin(episodes, evaluation, generator)

    def goals(self, step: int, observations: Array) -> Array:
        """Goals were chosen when the episodes began. Shape (episodes, state_dim)."""
        return self.skewed.planned(step)

    def wandering(self) -> NDArray[np.bool_] | None:
        """Nobody: noise at the ends of episodes is the rollout's business."""
        return None

    def observe(self, episodes: Episodes) -> Array:
        """The trajectory term of every reached state. Shape (episodes, steps)."""
        self.skewed.observe(episodes)
        return self.trajectory_term(episodes.observations[:, 1:, : self.goal_dim])

    def trajectory_term(self, states: Array) -> Array:
        """What of the reward depends on the trajectory, but not on the goal: nothing here.

        Args:
            states: Of whole trajectories. Shape (episodes, steps, state_dim).

        Returns:
            Shape (episodes, steps).
        """
        return np.zeros(states.shape[:-1])

    def refresh(
        self, history: Replay, steps: int, generator: np.random.Generator
    ) -> dict[str, float]:
        """New density units and goals when due."""
        self.skewed.refresh(history, steps, generator)
        return {}

    def state_dict(self) -> State:
        """All that a continuation needs."""
        return self.skewed.state_dict()

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`."""
        self.skewed.load_state_dict(state)
