"""Return to where few have been, then explore from there (Go-Explore, arXiv:2004.12919).

Goals and rewards are Skew-Explore's. What differs is how an episode uses its time: it *goes* to a
goal until it arrives, gives up or stands still; then it *explores*, with correlated random actions
instead of the policy's; then it goes to the nearest of some goals drawn anew, and so on until it
ends. An episode that follows one proposal, or changes it whether it was reached or not, spends
most of its time on known ground, however good its policy is. Every part has a number that turns it
off; `docs/return-then-explore.md` says what each of them does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.checks import require_at_least, require_between, require_positive
from skewmi.train.exploration.scale import field_columns
from skewmi.train.exploration.skew_explore import SkewExplore, SkewExploreConfig
from skewmi.train.replay import Index, Replay
from skewmi.train.state import State, as_array


@dataclass(frozen=True)
class ReturnThenExploreConfig(SkewExploreConfig):
    """Return-then-explore: Skew-Explore's goals and reward, episodes in excursions.

    `switch_probability` has no effect here.
    """

    arrival_radius: float = 0.7
    """Distance from a goal at which it is reached, density units."""
    go_steps: int = 150
    """Steps after which a goal that is not reached is given up."""
    stall_steps: int = 15
    """Steps over which the motion is looked at; 0: standing still is no reason to give up."""
    stall_distance: float = 0.3
    """Motion over so many steps below which an episode stands still, density units."""
    explore_steps: int = 30
    """Steps of random motion once a goal is reached or given up; 0: none."""
    nearest_of: int = 5
    """The next goal is the nearest of so many proposals; 1: any."""
    revisit_probability: float = 0.0
    """Probability that the next goal is any visited state instead, however common: proposals are
    rare states, and never ask for the way back to where an episode begins."""
    keep_fields: tuple[str, ...] = ()
    """Fields that a next goal may keep as they are: what has been done to objects stays done."""
    keep_probability: float = 0.5
    """Probability with which it keeps each of them; 0: goals are proposals as they are."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_at_least(1, self, "go_steps", "nearest_of")
        require_at_least(0, self, "stall_steps", "explore_steps")
        require_positive(self, "arrival_radius", "stall_distance")
        require_between(0.0, 1.0, self, "revisit_probability", "keep_probability")


class Excursions:
    """What each of some episodes, side by side, is about: going to a goal, or exploring.

    Args:
        config: See `ReturnThenExploreConfig`.
        goals: First ones, density units. Shape (episodes, d).
        kept: Episodes that keep their first goal and never explore. Shape (episodes,).
        keep: Columns that a next goal may keep as they are. Shape (k,).

    Attributes:
        goals: Present ones. Shape (episodes, d).
        exploring: Which episodes move at random now. Shape (episodes,).
    """

    def __init__(
        self,
        config: ReturnThenExploreConfig,
        goals: Array,
        kept: NDArray[np.bool_],
        keep: Index | None = None,
    ) -> None:
        self._config, self._kept = config, kept
        self._keep: Index = np.zeros(0, dtype=np.int64) if keep is None else keep
        self.goals: Array = goals.copy()
        self.exploring: NDArray[np.bool_] = np.zeros(len(goals), dtype=np.bool_)
        self._since = np.zeros(len(goals), dtype=np.int64)
        self._path: list[Array] = []

    def step(
        self,
        states: Array,
        proposals: Array,
        generator: np.random.Generator,
        visited: Array | None = None,
    ) -> None:
        """Look at where the episodes are, and decide what they do next.

        Args:
            states: Density units. Shape (episodes, d).
            proposals: Present ones, density units. Shape (k, d).
            generator: Of the choice of next goals.
            visited: Any visited states, density units; none: goals are proposals. Shape (n, d).
        """
        c, now = self._config, len(self._path)
        self._path.append(states)
        elapsed = now - self._since
        going = ~(self.exploring | self._kept)
        over = np.linalg.norm(states - self.goals, axis=1) < c.arrival_radius
        over |= elapsed >= c.go_steps
        if 0 < c.stall_steps <= now:
            moved = np.linalg.norm(states - self._path[now - c.stall_steps], axis=1)
            over |= (elapsed >= c.stall_steps) & (moved < c.stall_distance)
        begun = going & over
        self.exploring |= begun
        self._since[begun] = now
        done = np.flatnonzero(self.exploring & (now - self._since >= c.explore_steps))
        if done.size:
            self.goals[done] = self._next_goals(states[done], proposals, generator, visited)
            self.exploring[done] = False
            self._since[done] = now

    def _next_goals(
        self,
        states: Array,
        proposals: Array,
        generator: np.random.Generator,
        visited: Array | None,
    ) -> Array:
        """For episodes in these states. Shape (n, d)."""
        c, n = self._config, len(states)
        drawn: Array = proposals[generator.integers(len(proposals), size=(n, c.nearest_of))]
        if c.revisit_probability > 0.0 and visited is not None and len(visited):
            back = generator.random(n) < c.revisit_probability
            drawn[back] = visited[generator.integers(len(visited), size=n)][back, None]
        if self._keep.size:
            stays = generator.random((n, 1, self._keep.size)) < c.keep_probability
            here = states[:, None, self._keep]
            drawn[..., self._keep] = np.where(stays, here, drawn[..., self._keep])
        nearest = np.linalg.norm(drawn - states[:, None], axis=-1).argmin(1)
        goals: Array = drawn[np.arange(n), nearest]
        return goals


class ReturnThenExplore(SkewExplore):
    """Satisfies `Exploration`."""

    def __init__(
        self,
        config: ReturnThenExploreConfig,
        layout: PolicyLayout,
        generator: np.random.Generator,
    ) -> None:
        super().__init__(config, layout, generator)
        self._excursion_config = config
        self._keep = field_columns(layout, config.keep_fields)
        self._visited: Array = np.zeros((0, layout.state_dim))
        self.moves_at_random = config.explore_steps > 0

    def begin(self, episodes: int, evaluation: int, generator: np.random.Generator) -> None:
        """The first goals; those of evaluation and rewarded states are kept."""
        source = self.skewed.source(evaluation / episodes)
        goals, kept = source.draw(episodes, generator)
        goals[:evaluation] = source.evaluation_goals(evaluation, generator)
        kept[:evaluation] = True
        scale = self.skewed.scale
        self._excursions = Excursions(
            self._excursion_config, scale(goals, weighted=True), kept, self._keep
        )
        self._proposals: Array = scale(self.skewed.proposals, weighted=True)
        self._scaled_visited: Array = scale(self._visited, weighted=True)
        self._first, self._kept = goals, kept
        self._generator = generator

    def goals(self, step: int, observations: Array) -> Array:
        """Where the episodes go, or went before they began to explore. Shape (episodes, d)."""
        scale = self.skewed.scale
        states = scale(observations[:, : self.goal_dim], weighted=True)
        self._excursions.step(states, self._proposals, self._generator, self._scaled_visited)
        goals = scale.inverse(self._excursions.goals, weighted=True)
        # To the bit what they were: evaluation goals are compared.
        goals[self._kept] = self._first[self._kept]
        return goals

    def wandering(self) -> NDArray[np.bool_] | None:
        """Who explores. Shape (episodes,)."""
        return self._excursions.exploring

    def refresh(
        self, history: Replay, steps: int, generator: np.random.Generator
    ) -> dict[str, float]:
        """As Skew-Explore, and draws visited states that may be next goals."""
        measured = super().refresh(history, steps, generator)
        c = self._excursion_config
        if c.revisit_probability > 0.0:
            self._visited, _ = history.random_states(c.proposals, generator)
        return measured

    def state_dict(self) -> State:
        """All that a continuation needs, between two batches of episodes."""
        return super().state_dict() | {"visited": self._visited}

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`."""
        super().load_state_dict(state)
        # Checkpoints of earlier versions had none.
        self._visited = as_array(state.get("visited", self._visited))
