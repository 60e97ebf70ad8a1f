"""Goals from a density of visited states skewed towards rare ones (Skew-Fit, arXiv:1903.03698).

What Skew-Explore and its kin have in common: which goals are proposed, and what evaluation aims at;
which of them an episode gets and when it changes, `goal_plan.py` says. What being near a goal is
worth is up to the exploration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.checks import require, require_at_least, require_between, require_positive
from skewmi.train.density import kernel_log_density
from skewmi.train.exploration.goal_plan import GoalSource, plan_goals
from skewmi.train.exploration.protocol import ExplorationConfig
from skewmi.train.exploration.scale import Scale, running_scale, unit_scale
from skewmi.train.replay import Episodes, Index, Replay
from skewmi.train.running_mean_std import RunningMeanStd
from skewmi.train.state import State, as_array

_REWARDED_STATES = 512
"""Rewarded states kept to be goals."""


@dataclass(frozen=True)
class SkewedGoalsConfig(ExplorationConfig):
    """Which goals are proposed, and how episodes get them."""

    running_scale: bool = True
    """Density units: running mean and standard deviation (True) or the layout's units (False)."""
    scale_floor: float = 0.1
    """Smallest running standard deviation, as a fraction of half the field's range."""
    field_weights: tuple[tuple[str, float], ...] = ()
    """Fields whose distance counts more when goals are proposed: (name, factor)."""
    history_points: int = 5_000
    """Visited states behind the kernel density of everything visited."""
    history_bandwidth: float = 0.5
    """Of its kernels, in density units."""
    candidates: int = 12_000
    """States among which the goals are chosen."""
    candidates_from: Literal["history", "density"] = "history"
    """`history`: visited states, thus reachable; `density`: samples of the kernel density."""
    self_count: float = 1.0
    """A candidate's own kernel, added to its density: bounds the weight of an outlier."""
    weight_exponent: float = -2.5
    """Candidates drawn from p are weighted p to this power; the code's alpha plus one."""
    proposals: int = 100
    """Goals proposed at a time."""
    refresh_steps: int = 5_000
    """Environment steps between two proposals."""
    first_refresh_steps: int = 2_000
    """Environment steps before the first one."""
    switch_probability: float = 0.015
    """Probability per step that the goal changes within an episode."""
    rewarded_goal_max: float = 0.7
    """Highest probability that an episode gets a rewarded state as its goal, evaluated ones
    included: the others explore."""
    rewarded_goal_per_success: float = 0.01
    """Growth of that probability per rewarded episode."""

    def __post_init__(self) -> None:
        super().__post_init__()
        allowed = ("history", "density")
        require(
            self.candidates_from in allowed,
            f"candidates_from is {self.candidates_from!r}; allowed: {', '.join(allowed)}",
        )
        require_positive(self, "history_bandwidth")
        require_at_least(1, self, "history_points", "candidates", "proposals")
        require_at_least(
            0,
            self,
            "scale_floor",
            "self_count",
            "refresh_steps",
            "first_refresh_steps",
            "rewarded_goal_per_success",
        )
        require_between(0.0, 1.0, self, "switch_probability", "rewarded_goal_max")
        require(
            all(weight > 0.0 for _, weight in self.field_weights),
            f"field_weights are {dict(self.field_weights)}, must be positive; a field that hardly "
            "counts has a small one",
        )


def skew_weights(log_density: Array, exponent: float) -> Array:
    """Weights that flatten the density of visited states.

    w_i ∝ p(s_i)^exponent for s_i drawn from p, so the result is distributed like
    p^(1 + exponent): 0 keeps p, -1 makes it uniform, less than -1 prefers the rare. The
    published code writes p p^alpha; its alpha of -2.1 is our exponent -1.1.

    Args:
        log_density: log p(s_i). Shape (n,).
        exponent: See above.

    Returns:
        Weights summing to one. Shape (n,).
    """
    logits = exponent * log_density
    weights = np.exp(logits - logits.max())
    normalized: Array = weights / weights.sum()
    return normalized


def propose(
    history: Replay, scale: Scale, config: SkewedGoalsConfig, generator: np.random.Generator
) -> tuple[Array, Index]:
    """Draw goals from the skewed density of everything visited.

    Args:
        history: Holds what was visited.
        scale: Density units.
        config: See `SkewedGoalsConfig`.
        generator: Of the random choices.

    Returns:
        Goals in the task's units, shape (proposals, state_dim), and the history's slots of the
        episodes they were met in, shape (proposals,); no slots if they are samples of a density.
    """
    visited, _ = history.random_states(config.history_points, generator)
    points = scale(visited, weighted=True)
    h = config.history_bandwidth
    if config.candidates_from == "history":
        visited, slots = history.random_states(config.candidates, generator)
        candidates = scale(visited, weighted=True)
    else:
        index = generator.integers(len(points), size=config.candidates)
        candidates = points[index] + h * generator.standard_normal((len(index), points.shape[1]))
    log_density = kernel_log_density(candidates, points, h, self_count=config.self_count)
    weights = skew_weights(log_density, config.weight_exponent)
    index = generator.choice(len(candidates), size=config.proposals, p=weights)
    chosen = candidates[index]
    if config.candidates_from == "density":
        # The published code draws from another kernel density around the weighted samples.
        chosen = chosen + h * generator.standard_normal(chosen.shape)
        return scale.inverse(chosen, weighted=True), np.zeros(0, dtype=np.int64)
    return scale.inverse(chosen, weighted=True), slots[index]


def left_to_reward(most: float, evaluated: float) -> float:
    """Highest probability of a rewarded goal for episodes that are not evaluated.

    Args:
        most: Of all episodes.
        evaluated: Share of episodes that are, below 1.
    """
    return max(0.0, most - evaluated) / (1.0 - evaluated)


class SkewedGoals:
    """Density units, proposals and evaluation goal of a run, as they change.

    Attributes:
        scale: Density units.
        proposals: Present goals. Shape (k, state_dim).
        proposal_episodes: Slots of the episodes they were met in. Shape (k,) or (0,).
        refreshes: How often goals were proposed.
        evaluation_goal: Once a reward was met, the most central of the recently rewarded states;
            before that, the last proposal. Shape (state_dim,).
    """

    def __init__(
        self, config: SkewedGoalsConfig, layout: PolicyLayout, generator: np.random.Generator
    ) -> None:
        self.config, self.layout = config, layout
        self.running = RunningMeanStd(layout.state_dim)
        self.scale: Scale = unit_scale(layout, config.field_weights)
        d = layout.state_dim
        low, high = layout.observation_low[:d], layout.observation_high[:d]
        # Before anything is known, goals are uniform over the nominal ranges.
        self.proposals: Array = generator.uniform(low, high, (config.proposals, d))
        self.proposal_episodes: Index = np.zeros(0, dtype=np.int64)
        self.evaluation_goal: Array = self.proposals[0]
        self._rewarded_states: Array = np.zeros((0, d))
        self._rewarded_episodes = 0
        self.refreshes = 0
        self._next_refresh = config.first_refresh_steps
        self._planned: Array = np.zeros((0, layout.episode_steps, d))

    def begin(self, episodes: int, evaluation: int, generator: np.random.Generator) -> None:
        """Choose the goals of the next episodes, see `plan_goals`."""
        steps, switch = self.layout.episode_steps, self.config.switch_probability
        source = self.source(evaluation / episodes)
        self._planned = plan_goals(source, episodes, steps, evaluation, switch, generator)

    def source(self, evaluated: float) -> GoalSource:
        """Where the goals of the next episodes come from, of which such a share is evaluated."""
        c = self.config
        probability = min(
            left_to_reward(c.rewarded_goal_max, evaluated),
            c.rewarded_goal_per_success * self._rewarded_episodes,
        )
        return GoalSource(self.proposals, self._rewarded_states, self.evaluation_goal, probability)

    def planned(self, step: int) -> Array:
        """Goals of a step of these episodes. Shape (episodes, state_dim)."""
        return self._planned[:, step]

    def observe(self, episodes: Episodes) -> None:
        """Take in finished episodes."""
        first = self.running.count == 0.0
        states = episodes.observations[:, 1:, : self.layout.state_dim]
        self.running.update(states.reshape(-1, self.layout.state_dim))
        if first:
            self._rescale()  # the first trajectories need units too
        self._rewarded_episodes += int((episodes.rewards > 0.0).any(1).sum())

    def refresh(self, history: Replay, steps: int, generator: np.random.Generator) -> None:
        """When due after `steps`: new density units, proposals and evaluation goal."""
        if steps < self._next_refresh:
            return
        self.refreshes += 1
        self._next_refresh = steps + self.config.refresh_steps
        self._rescale()
        self.proposals, self.proposal_episodes = propose(
            history, self.scale, self.config, generator
        )
        self._rewarded_states = history.rewarded_states(_REWARDED_STATES, generator)
        if len(self._rewarded_states):
            x = self.scale(self._rewarded_states, weighted=False)
            distance = np.linalg.norm(x[:, None] - x[None], axis=-1).sum(1)
            self.evaluation_goal = self._rewarded_states[int(np.argmin(distance))]
        else:
            self.evaluation_goal = self.proposals[-1]

    def _rescale(self) -> None:
        c = self.config
        if c.running_scale:
            self.scale = running_scale(self.layout, self.running, c.scale_floor, c.field_weights)

    def state_dict(self) -> State:
        """All that a continuation needs, between two batches of episodes."""
        return {
            "running": self.running.state_dict(),
            "scale": self.scale.state_dict(),
            "proposals": self.proposals,
            "proposal_episodes": self.proposal_episodes,
            "evaluation_goal": self.evaluation_goal,
            "rewarded_states": self._rewarded_states,
            "rewarded_episodes": self._rewarded_episodes,
            "next_refresh": self._next_refresh,
            "refreshes": self.refreshes,
        }

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`."""
        self.running.load_state_dict(state["running"])
        self.scale = Scale.from_state_dict(state["scale"])
        self.proposals = as_array(state["proposals"])
        self.proposal_episodes = as_array(state["proposal_episodes"]).astype(np.int64)
        self.evaluation_goal = as_array(state["evaluation_goal"])
        self._rewarded_states = as_array(state["rewarded_states"])
        self._rewarded_episodes = int(state["rewarded_episodes"])
        self._next_refresh = int(state["next_refresh"])
        # Checkpoints of earlier versions do not tell: counted from there.
        self.refreshes = int(state.get("refreshes", 0))
