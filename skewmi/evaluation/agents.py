"""Policies without learning: what a task gives away for free."""

from __future__ import annotations

import numpy as np

from skewmi.policy_io import Array, PolicyLayout


class ZeroAgent:
    """Always the zero action; satisfies `policy_io.Policy`."""

    def __init__(self, layout: PolicyLayout) -> None:
        self.layout = layout

    def reset(self) -> None:
        """Nothing to forget."""

    def act(self, observation: Array) -> Array:
        """Zeros. Shape (..., observation_dim) -> (..., action_dim)."""
        return np.zeros((*np.shape(observation)[:-1], self.layout.action_dim))


_STREAM = 3
"""Of random actions: environments draw starts by the seed alone, learners by it and 1 or 2."""


class RandomAgent:
    """Uniform actions, independent from step to step; satisfies `policy_io.Policy`.

    Its random stream is its own, so that no action repeats what an environment of the same seed
    draws its starts by.
    """

    def __init__(self, layout: PolicyLayout, seed: int) -> None:
        self.layout = layout
        self._generator = np.random.default_rng([seed, _STREAM])

    def reset(self) -> None:
        """Nothing to forget; the random stream goes on."""

    def act(self, observation: Array) -> Array:
        """Uniform in [-1, 1]. Shape (..., observation_dim) -> (..., action_dim)."""
        shape = (*np.shape(observation)[:-1], self.layout.action_dim)
        return self._generator.uniform(-1.0, 1.0, shape)
