"""Skew-Explore: where to go next, and what being there is worth.

Goals z are drawn from a density of visited states skewed towards rare ones
(Skew-Fit, arXiv:1903.03698); the policy is paid, at every state s of a trajectory tau,

    r = w_int (log p_z(s) - log p_tau(s)) + w_ext r_ext(s),     p_z = N(z, sigma^2 I),

which is highest for a trajectory spread like p_z: it explores around z. Every departure from
the publication is a named switch of `SkewConfig`; `docs/paper.md` lists them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array
from skewmi.train.config import SkewConfig
from skewmi.train.density import (
    Scale,
    gaussian_log_density,
    kernel_log_density,
    trajectory_log_density,
)
from skewmi.train.replay import Index, Replay


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
    replay: Replay, scale: Scale, config: SkewConfig, generator: np.random.Generator
) -> tuple[Array, Index]:
    """Draw goals from the skewed density of everything visited.

    Args:
        replay: Holds what was visited.
        scale: Density units.
        config: See `SkewConfig`.
        generator: Of the random choices.

    Returns:
        Goals in the task's units, shape (goals, state_dim), and the replay's slots of
        the episodes they were met in, shape (goals,); no slots if they are samples of a density.
    """
    visited, _ = replay.random_states(config.history_points, generator)
    points = scale(visited, weighted=True)
    h = config.history_bandwidth
    if config.candidates_from == "history":
        visited, slots = replay.random_states(config.candidates, generator)
        candidates = scale(visited, weighted=True)
    else:
        index = generator.integers(len(points), size=config.candidates)
        candidates = points[index] + h * generator.standard_normal((len(index), points.shape[1]))
    log_density = kernel_log_density(candidates, points, h, self_count=config.self_count)
    weights = skew_weights(log_density, config.weight_exponent)
    index = generator.choice(len(candidates), size=config.goals, p=weights)
    chosen = candidates[index]
    if config.candidates_from == "density":
        # The published code draws from another kernel density around the weighted samples.
        chosen = chosen + h * generator.standard_normal(chosen.shape)
        return scale.inverse(chosen, weighted=True), np.zeros(0, dtype=np.int64)
    return scale.inverse(chosen, weighted=True), slots[index]


@dataclass(frozen=True)
class RewardTerms:
    """Everything that turns a state, a goal and log p_tau into a reward."""

    config: SkewConfig
    scale: Scale

    def log_p_z(self, states: NDArray[np.floating], goals: NDArray[np.floating]) -> Array:
        """Clipped log p_z. Shapes (..., d) broadcast -> (...)."""
        c, weighted = self.config, self.config.weights_in_reward
        # Only the difference counts, so the offset of the scale drops out.
        unit = self.scale.unit / self.scale.weight if weighted else self.scale.unit
        x, z = states / unit, goals / unit
        log_density = gaussian_log_density(x, z, c.sigma)
        return log_density if c.goal_clip is None else np.maximum(log_density, c.goal_clip)

    def log_p_tau(self, states: Array) -> Array:
        """Clipped log p_tau of trajectories (episodes, steps, d) -> (episodes, steps)."""
        c = self.config
        scaled = self.scale(states, weighted=c.weights_in_reward)
        log_density = trajectory_log_density(
            scaled, c.trajectory_bandwidth, causal=c.trajectory_density == "prefix"
        )
        if c.trajectory_clip is None:
            return log_density
        clipped: Array = np.maximum(log_density, c.trajectory_clip)
        return clipped

    def reward(
        self,
        states: NDArray[np.floating],
        goals: NDArray[np.floating],
        log_tau: NDArray[np.floating],
        extrinsic: NDArray[np.floating],
    ) -> Array:
        """w_int (log p_z - log p_tau) + w_ext r_ext.

        Args:
            states: Reached states. Shape (..., d).
            goals: Goals, broadcasting with states.
            log_tau: log p_tau, clipped already. Shape (...).
            extrinsic: The task's reward. Shape (...).
        """
        c = self.config
        reward: Array = (
            c.intrinsic * (self.log_p_z(states, goals) - log_tau) + c.extrinsic * extrinsic
        )
        return reward
