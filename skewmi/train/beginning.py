"""What acts at the beginning of a run, before the learner does: random actions, or a teacher."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from skewmi.errors import PolicyFileError
from skewmi.policy_io import Array, Policy
from skewmi.train.noise import ExplorationNoise


class Beginning(Protocol):
    """Gives the actions of whole episodes instead of the learner."""

    def begin(
        self, shape: tuple[int, int, int], evaluation: int, generator: np.random.Generator
    ) -> None:
        """Episodes begin.

        Args:
            shape: Episodes, steps of each, size of an action.
            evaluation: The first so many are to be without anything random, where that is possible.
            generator: Of everything random until the episodes' end.
        """

    def act(self, step: int, observations: Array) -> Array:
        """Actions of one step. Shape (n, observation_dim) -> (n, action_dim)."""


class RandomBeginning:
    """Uniform random actions."""

    def begin(
        self, shape: tuple[int, int, int], evaluation: int, generator: np.random.Generator
    ) -> None:
        """See `Beginning`."""
        self._shape, self._generator = (shape[0], shape[2]), generator

    def act(self, step: int, observations: Array) -> Array:
        """See `Beginning`."""
        return self._generator.uniform(-1.0, 1.0, self._shape)


class TaughtBeginning:
    """The actions of a policy that can do something of the task already.

    Args:
        teacher: For the same observations and actions.
        noise_probability, noise_correlation: Of the random motion that some of its episodes end
            in, see `ExplorationNoise`: without it the learner sees one way to act in every state.
    """

    def __init__(
        self, teacher: Policy, *, noise_probability: float, noise_correlation: float
    ) -> None:
        self._teacher = teacher
        self._probability, self._correlation = noise_probability, noise_correlation

    def begin(
        self, shape: tuple[int, int, int], evaluation: int, generator: np.random.Generator
    ) -> None:
        """See `Beginning`."""
        self._teacher.reset()
        self._noise = ExplorationNoise(
            shape,
            probability=self._probability,
            correlation=self._correlation,
            spared=evaluation,
            generator=generator,
        )

    def act(self, step: int, observations: Array) -> Array:
        """See `Beginning`.

        Raises:
            PolicyFileError: The teacher's actions are not finite.
        """
        action = self._teacher.act(observations)
        if not np.isfinite(action).all():
            raise PolicyFileError("the teacher's actions are not finite: it cannot begin a run")
        return self._noise.apply(step, np.clip(action, -1.0, 1.0))
