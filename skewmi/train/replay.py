"""Whole episodes in one preallocated array, hindsight drawn at sampling time.

Layout of the array, columns of one row (float32):

    observation | action | goal | reward | trajectory term

Row t of an episode holds the observation before step t, the action and goal of step t, and the
extrinsic reward and the trajectory term of the state that step t led to. The last row,
t = episode_steps, holds the last observation only. The trajectory term is what of the intrinsic
reward does not depend on the goal (see `exploration.protocol`), so one scalar per transition is
all that relabelling needs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array, PolicyLayout

Index = NDArray[np.int64]
Single = NDArray[np.float32]


@dataclass(frozen=True)
class Episodes:
    """Finished episodes, in the task's units.

    Attributes:
        observations: Shape (episodes, steps + 1, observation_dim).
        actions: Shape (episodes, steps, action_dim).
        goals: Shape (episodes, steps, goal_dim).
        rewards: Extrinsic, after each step. Shape (episodes, steps).
    """

    observations: Array
    actions: Array
    goals: Array
    rewards: Array


@dataclass(frozen=True)
class Transitions:
    """Drawn n-step transitions, not yet relabelled.

    Attributes:
        episode: Slot of the episode. Shape (n,).
        step: Step the transition starts at. Shape (n,).
        observation: Shape (n, observation_dim).
        action: Shape (n, action_dim).
        goal: As collected. Shape (n, goal_dim).
        length: Steps summed, n_step or less at the end of an episode. Shape (n,).
        states: States after each of them. Shape (n, n_step, state_dim).
        rewards: Extrinsic. Shape (n, n_step).
        trajectory_term: As stored. Shape (n, n_step).
        next_observation: After `length` steps. Shape (n, observation_dim).
        at_end: Whether that is the end of the episode. Shape (n,).
    """

    episode: Index
    step: Index
    observation: Single
    action: Single
    goal: Single
    length: Index
    states: Single
    rewards: Single
    trajectory_term: Single
    next_observation: Single
    at_end: NDArray[np.bool_]


class Replay:
    """A ring of whole episodes: what a run has visited.

    Args:
        layout: Of the task.
        capacity_steps: Steps kept at most, at least one episode.
        goal_dim: Size of a goal, 0 without goals.
    """

    def __init__(self, layout: PolicyLayout, capacity_steps: int, goal_dim: int) -> None:
        self.steps = layout.episode_steps
        self.capacity = max(1, capacity_steps // self.steps)
        o, a, s = layout.observation_dim, layout.action_dim, layout.state_dim
        ends = np.cumsum([o, a, goal_dim, 1, 1])
        self._observation = slice(0, o)
        self._state = slice(0, s)
        self._action = slice(o, int(ends[1]))
        self._goal = slice(int(ends[1]), int(ends[2]))
        self._reward, self._trajectory_term = int(ends[2]), int(ends[3])
        self.columns = int(ends[4])
        # Zeroed pages are not backed by memory until an episode lands there.
        self.rows: Single = np.zeros((self.capacity, self.steps + 1, self.columns), np.float32)
        self.rewarded = np.zeros(self.capacity, dtype=np.bool_)
        self.count = 0
        """Episodes ever added; episode i lives in slot i modulo capacity."""

    def __len__(self) -> int:
        """Episodes held."""
        return min(self.count, self.capacity)

    @property
    def transitions(self) -> int:
        """Transitions held."""
        return len(self) * self.steps

    def add(self, episodes: Episodes, trajectory_term: Array) -> None:
        """Append finished episodes; trajectory_term of shape (episodes, steps)."""
        n = len(episodes.actions)
        slots = (self.count + np.arange(n)) % self.capacity
        rows = np.zeros((n, self.steps + 1, self.columns), np.float32)
        rows[:, :, self._observation] = episodes.observations
        rows[:, :-1, self._action] = episodes.actions
        rows[:, :-1, self._goal] = episodes.goals
        rows[:, :-1, self._reward] = episodes.rewards
        rows[:, :-1, self._trajectory_term] = trajectory_term
        self.rows[slots] = rows
        self.count += n
        self.refresh_index(slots)

    def refresh_index(self, slots: Index) -> None:
        """Recompute what is derived from the rows of some slots."""
        self.rewarded[slots] = self.rows[slots, :-1, self._reward].any(1)

    def state_columns(self, slots: Index) -> tuple[Single, Single]:
        """States (n, steps + 1, d) and extrinsic rewards (n, steps) of some slots."""
        rows = self.rows[slots]
        return rows[:, :, self._state], rows[:, :-1, self._reward]

    def goal_columns(self, slots: Index) -> Single:
        """Goals (n, steps, goal_dim) that the episodes of some slots pursued."""
        goals: Single = self.rows[slots, :-1, self._goal]
        return goals

    def random_states(self, count: int, generator: np.random.Generator) -> tuple[Array, Index]:
        """States met after a step, drawn uniformly with replacement.

        Returns:
            States, shape (count, d), and the slots of their episodes, shape (count,).
        """
        slots = generator.integers(len(self), size=count)
        steps = generator.integers(1, self.steps + 1, size=count)
        states: Array = self.rows[slots, steps, self._state].astype(np.float64)
        return states, slots

    def distinct_states(self, count: int, generator: np.random.Generator) -> Array:
        """Up to `count` states met after a step, drawn uniformly without replacement. Shape (n, d).

        No step of an episode is drawn twice; states of different steps may still be equal.
        """
        drawn = generator.choice(
            self.transitions, size=min(count, self.transitions), replace=False, shuffle=False
        )
        slots, steps = np.divmod(drawn, self.steps)
        states: Array = self.rows[slots, steps + 1, self._state].astype(np.float64)
        return states

    def rewarded_states(self, count: int, generator: np.random.Generator) -> Array:
        """Up to `count` states that were paid, of recent rewarded episodes. Shape (n, d)."""
        slots = np.flatnonzero(self.rewarded)
        if self.count > self.capacity:  # oldest first
            slots = slots[np.argsort((slots - self.count) % self.capacity, kind="stable")]
        rows = self.rows[slots[-50:]]
        states = rows[:, 1:, self._state][rows[:, :-1, self._reward] > 0.0].astype(np.float64)
        if len(states) > count:
            states = states[generator.choice(len(states), size=count, replace=False)]
        return states

    def draw(
        self,
        count: int,
        n_step: int,
        rewarded_fraction: float,
        generator: np.random.Generator,
        *,
        rare: Index | None = None,
        rare_fraction: float = 0.0,
    ) -> Transitions:
        """Draw transitions uniformly, but for a fraction from rewarded and one from rare episodes.

        Args:
            count: How many.
            n_step: Steps of reward each sums at most.
            rewarded_fraction: Share from episodes with extrinsic reward, if there are any.
            generator: Of the random choices.
            rare: Slots of episodes that met rare states. Shape (k,), k may be 0.
            rare_fraction: Share from those, if there are any.
        """
        episode = generator.integers(len(self), size=count)
        kind = generator.random(count)
        slots = np.flatnonzero(self.rewarded[: len(self)])
        if rare is not None and len(rare):
            drawn = rare[generator.integers(len(rare), size=count)]
            episode = np.where(kind > 1.0 - rare_fraction, drawn, episode)
        if len(slots):
            drawn = slots[generator.integers(len(slots), size=count)]
            episode = np.where(kind < rewarded_fraction, drawn, episode)
        step = generator.integers(self.steps, size=count)
        first = self.rows[episode, step]
        length = np.minimum(n_step, self.steps - step)
        # Beyond the end the last rows repeat; `length` masks them.
        ahead = step[:, None] + np.arange(n_step)
        paid = self.rows[episode[:, None], np.minimum(ahead, self.steps - 1)]
        reached = self.rows[episode[:, None], np.minimum(ahead + 1, self.steps)]
        return Transitions(
            episode=episode,
            step=step,
            observation=first[:, self._observation],
            action=first[:, self._action],
            goal=first[:, self._goal],
            length=length,
            states=reached[:, :, self._state],
            rewards=paid[:, :, self._reward],
            trajectory_term=paid[:, :, self._trajectory_term],
            next_observation=reached[np.arange(count), length - 1, self._observation],
            at_end=step + length == self.steps,
        )

    def future_states(self, episode: Index, step: Index, generator: np.random.Generator) -> Single:
        """States reached after `step` in the same episode, uniformly. Shape (n, state_dim)."""
        later = generator.integers(step + 1, self.steps + 1)
        states: Single = self.rows[episode, later, self._state]
        return states
