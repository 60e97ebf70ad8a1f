"""Which goal each of a batch of episodes has at each of its steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array


@dataclass(frozen=True)
class GoalSource:
    """Where the goals of a batch of episodes come from.

    Attributes:
        proposals: Of the skewed density. Shape (k, state_dim).
        rewarded: Rewarded states that may be given as goals. Shape (m, state_dim), m may be 0.
        evaluation_goal: The one that evaluation episodes get. Shape (state_dim,).
        rewarded_goal_probability: Probability that an episode is given a rewarded state.
    """

    proposals: Array
    rewarded: Array
    evaluation_goal: Array
    rewarded_goal_probability: float

    def draw(self, count: int, generator: np.random.Generator) -> tuple[Array, NDArray[np.bool_]]:
        """Goals (count, state_dim), and which of them are rewarded states."""
        goals = self.proposals[generator.integers(len(self.proposals), size=count)]
        rewarded = generator.random(count) < self.rewarded_goal_probability
        if not len(self.rewarded):
            return goals, np.zeros(count, dtype=np.bool_)
        chosen = self.rewarded[generator.integers(len(self.rewarded), size=count)]
        return np.where(rewarded[:, None], chosen, goals), rewarded

    def evaluation_goals(self, count: int, generator: np.random.Generator) -> Array:
        """Goals of the episodes that tell whether the task is learned. Shape (count, state_dim).

        The first is the evaluation goal, the others are rewarded states, each another one if there
        are enough: so the episodes differ even where nothing else is random. While no state was
        rewarded, nothing is drawn, and all are the evaluation goal.
        """
        goals = np.repeat(self.evaluation_goal[None], count, axis=0)
        others, known = count - 1, len(self.rewarded)
        if others > 0 and known:
            goals[1:] = self.rewarded[generator.choice(known, size=others, replace=others > known)]
        return goals


def plan_goals(
    source: GoalSource,
    num_envs: int,
    steps: int,
    evaluation: int,
    switch_probability: float,
    generator: np.random.Generator,
) -> Array:
    """Goal of every step of a batch of episodes.

    The first `evaluation` episodes keep what `GoalSource.evaluation_goals` gives. The others start
    with a draw and, unless that gave a rewarded state, change to another proposal with
    `switch_probability` at every step: the policy then learns to go from one region to the next,
    not only from the start.

    Returns:
        Shape (num_envs, steps, state_dim).
    """
    first, rewarded = source.draw(num_envs, generator)
    switch = generator.random((num_envs, steps)) < switch_probability
    switch[rewarded] = False
    switch[:, 0] = True
    fresh = source.proposals[generator.integers(len(source.proposals), size=(num_envs, steps))]
    fresh[:, 0] = first
    # Index of the latest switch at or before every step.
    latest = np.maximum.accumulate(np.where(switch, np.arange(steps), 0), axis=1)
    goals: Array = np.take_along_axis(fresh, latest[:, :, None], axis=1)
    goals[:evaluation] = source.evaluation_goals(evaluation, generator)[:, None]
    return goals
