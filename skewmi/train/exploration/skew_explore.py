"""Skew-Explore: what being somewhere on the way to a goal is worth.

Goals z are drawn from a density of visited states skewed towards rare ones (`goals.py`); the
policy is paid, at every state s of a trajectory tau,

    r = w_int (log p_z(s) - log p_tau(s)) + w_ext r_ext(s),     p_z = N(z, sigma^2 I),

which is highest for a trajectory spread like p_z: it explores around z. Every departure from
the publication is a named switch of `SkewExploreConfig`; `docs/paper.md` lists them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.checks import require, require_positive
from skewmi.train.density import gaussian_log_density, trajectory_log_density
from skewmi.train.exploration.goal_exploration import GoalExploration
from skewmi.train.exploration.goals import SkewedGoalsConfig


@dataclass(frozen=True)
class SkewExploreConfig(SkewedGoalsConfig):
    """Skew-Explore: goals from a skewed density, reward from two densities."""

    intrinsic: float = 0.005
    """w_int, in front of log p_z(s) - log p_tau(s)."""
    extrinsic: float = 1.0
    """w_ext, in front of the task's reward of 1 per step."""
    sigma: float = 0.7
    """Standard deviation of p_z around the goal, in density units."""
    trajectory_bandwidth: float = 0.2
    """Of the kernels of p_tau, in density units."""
    trajectory_density: Literal["prefix", "whole"] = "prefix"
    """`prefix`: the trajectory up to now (causal); `whole`: all of it (Eqs. 3-4)."""
    goal_clip: float | None = -20.0
    """Lower clip of log p_z."""
    trajectory_clip: float | None = -50.0
    """Lower clip of log p_tau."""
    weights_in_reward: bool = False
    """Whether the field weights also shape p_z and p_tau."""

    def __post_init__(self) -> None:
        super().__post_init__()
        allowed = ("prefix", "whole")
        require(
            self.trajectory_density in allowed,
            f"trajectory_density is {self.trajectory_density!r}; allowed: {', '.join(allowed)}",
        )
        require_positive(self, "sigma", "trajectory_bandwidth")


def clipped(log_density: Array, low: float | None) -> Array:
    """A log density with a lower bound, or without one."""
    return log_density if low is None else np.maximum(log_density, low)


class SkewExplore(GoalExploration):
    """Satisfies `Exploration`.

    log p_tau does not depend on z: it is the trajectory term that is stored with the episodes,
    in the density units of that moment; later changes of units shift it by a constant.
    """

    def __init__(
        self, config: SkewExploreConfig, layout: PolicyLayout, generator: np.random.Generator
    ) -> None:
        super().__init__(config, layout, generator)
        self.config = config
        self.extrinsic_weight = config.extrinsic

    def trajectory_term(self, states: Array) -> Array:
        """Clipped log p_tau of trajectories (episodes, steps, d) -> (episodes, steps)."""
        c = self.config
        scaled = self.skewed.scale(states, weighted=c.weights_in_reward)
        log_density = trajectory_log_density(
            scaled, c.trajectory_bandwidth, causal=c.trajectory_density == "prefix"
        )
        return clipped(log_density, c.trajectory_clip)

    def log_p_z(self, states: NDArray[np.floating], goals: NDArray[np.floating]) -> Array:
        """Clipped log p_z. Shapes (..., d) broadcast -> (...)."""
        c, scale = self.config, self.skewed.scale
        # Only the difference counts, so the offset of the scale drops out.
        unit = scale.unit / scale.weight if c.weights_in_reward else scale.unit
        log_density = gaussian_log_density(states / unit, goals / unit, c.sigma)
        return clipped(log_density, c.goal_clip)

    def intrinsic_reward(
        self,
        states: NDArray[np.floating],
        goals: NDArray[np.floating],
        trajectory_term: NDArray[np.floating],
    ) -> Array:
        """w_int (log p_z - log p_tau), see `Exploration`."""
        reward: Array = self.config.intrinsic * (self.log_p_z(states, goals) - trajectory_term)
        return reward
