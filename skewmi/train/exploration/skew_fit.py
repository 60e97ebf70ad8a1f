"""Skew-Fit: being near the goal is worth something, and nothing else is.

Goals z are drawn as in Skew-Explore (`goals.py`); the policy is paid, at every state s,

    r = -w_int |s - z|^k + w_ext r_ext(s),     k = 1 (the published code) or 2,

with the distance in density units. k = 2 is what is left of Skew-Explore's reward as sigma goes to
0, in units of 1 / (2 sigma^2): log p_z(s) is -|s - z|^2 / (2 sigma^2) but for a constant, and
log p_tau, which does not depend on sigma, vanishes beside it. `docs/skew-fit.md` says more.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.checks import require
from skewmi.train.exploration.goal_exploration import GoalExploration
from skewmi.train.exploration.goals import SkewedGoalsConfig


@dataclass(frozen=True)
class SkewFitConfig(SkewedGoalsConfig):
    """Skew-Fit: goals from a skewed density, reward from the distance to them."""

    intrinsic: float = 0.05
    """w_int, in front of the distance to the goal."""
    extrinsic: float = 1.0
    """w_ext, in front of the task's reward of 1 per step."""
    distance: Literal["euclidean", "squared"] = "euclidean"
    """`euclidean`: the published code's; `squared`: Skew-Explore's limit as sigma goes to 0."""
    weights_in_reward: bool = False
    """Whether the field weights also shape the distance."""

    def __post_init__(self) -> None:
        super().__post_init__()
        allowed = ("euclidean", "squared")
        require(
            self.distance in allowed,
            f"distance is {self.distance!r}; allowed: {', '.join(allowed)}",
        )


class SkewFit(GoalExploration):
    """Satisfies `Exploration`."""

    def __init__(
        self, config: SkewFitConfig, layout: PolicyLayout, generator: np.random.Generator
    ) -> None:
        super().__init__(config, layout, generator)
        self.config = config
        self.extrinsic_weight = config.extrinsic

    def intrinsic_reward(
        self,
        states: NDArray[np.floating],
        goals: NDArray[np.floating],
        trajectory_term: NDArray[np.floating],
    ) -> Array:
        """-w_int |s - z|^k, see `Exploration`; the trajectory does not matter."""
        c, scale = self.config, self.skewed.scale
        # Only the difference counts, so the offset of the scale drops out.
        unit = scale.unit / scale.weight if c.weights_in_reward else scale.unit
        squared = np.square((states - goals) / unit).sum(-1)
        distance = squared if c.distance == "squared" else np.sqrt(squared)
        reward: Array = -c.intrinsic * distance
        return reward
