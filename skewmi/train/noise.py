"""Correlated random motion in place of a policy's actions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array


class ExplorationNoise:
    """Correlated random actions from a drawn step of an episode to its end.

    a_t = rho a_{t-1} + sqrt(1 - rho^2) e_t with e_t standard normal: stays away from the
    policy's habits for long enough to get somewhere, which white noise does not.

    Args:
        shape: Episodes, steps of each, size of an action.
        probability: That an episode ends so.
        correlation: rho.
        spared: The first so many episodes get none.
        generator: Of everything random here.
    """

    def __init__(
        self,
        shape: tuple[int, int, int],
        probability: float,
        correlation: float,
        *,
        spared: int,
        generator: np.random.Generator,
    ) -> None:
        num_envs, steps, action_dim = shape
        self.correlation = correlation
        self.generator = generator
        begin = generator.integers(0, steps, size=num_envs)
        self.begin = np.where(generator.random(num_envs) < probability, begin, steps)
        self.begin[:spared] = steps
        self.noise: Array = generator.standard_normal((num_envs, action_dim))

    def apply(self, step: int, action: Array, wandering: NDArray[np.bool_] | None = None) -> Array:
        """Replace the actions of the episodes whose noise has begun, and of some others.

        Args:
            step: Of the episodes.
            action: The policy's. Shape (n, action_dim).
            wandering: The others. Shape (n,).
        """
        innovation = self.generator.standard_normal(self.noise.shape)
        self.noise = self.correlation * self.noise + np.sqrt(1 - self.correlation**2) * innovation
        chosen = step >= self.begin
        if wandering is not None:
            chosen = chosen | wandering
        return np.where(chosen[:, None], np.clip(self.noise, -1.0, 1.0), action)
