"""What acts instead of the learner: random actions or a teacher, at first or in some episodes."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from skewmi.errors import PolicyFileError
from skewmi.policy_io import Array, Policy
from skewmi.train.noise import ExplorationNoise

Chosen = NDArray[np.bool_]


class Beginning(Protocol):
    """Gives actions instead of the learner: of whole episodes, or of how they begin.

    Attributes:
        whole: Of whole episodes, evaluated ones included.
    """

    whole: bool

    def begin(
        self, shape: tuple[int, int, int], evaluation: int, generator: np.random.Generator
    ) -> None:
        """Episodes begin.

        Args:
            shape: Episodes, steps of each, size of an action.
            evaluation: The first so many are to be without anything random, where that is possible.
            generator: Of everything random until the episodes' end.
        """

    def act(self, step: int, observations: Array) -> tuple[Array, Chosen]:
        """Actions of one step, and in which episodes they replace the learner's.

        Args:
            step: Of the episodes.
            observations: Shape (n, observation_dim).

        Returns:
            Shapes (n, action_dim) and (n,).
        """


class RandomBeginning:
    """Uniform random actions, of whole episodes."""

    whole = True

    def begin(
        self, shape: tuple[int, int, int], evaluation: int, generator: np.random.Generator
    ) -> None:
        """See `Beginning`."""
        self._shape, self._generator = (shape[0], shape[2]), generator

    def act(self, step: int, observations: Array) -> tuple[Array, Chosen]:
        """See `Beginning`."""
        actions = self._generator.uniform(-1.0, 1.0, self._shape)
        return actions, np.ones(len(actions), np.bool_)


class TaughtBeginning:
    """Whole episodes of a policy that can do something of the task already.

    Args:
        teacher: For the same observations and actions.
        noise_probability, noise_correlation: Of the random motion that some of its episodes end
            in, see `ExplorationNoise`: without it the learner sees one way to act in every state.
    """

    whole = True

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
            *(self._probability, self._correlation),
            spared=evaluation,
            generator=generator,
        )

    def act(self, step: int, observations: Array) -> tuple[Array, Chosen]:
        """See `Beginning`.

        Raises:
            PolicyFileError: The teacher's actions are not finite.
        """
        actions = self._noise.apply(step, _taught(self._teacher, observations))
        return actions, np.ones(len(actions), np.bool_)


class HandOver:
    """A teacher begins some episodes and hands them over to the learner at a drawn step.

    What the learner believes of states that only the teacher gets to is corrected there, and not
    after it has found its own way to them. (Uchendu et al., Jump-start reinforcement learning,
    arXiv:2204.02372, hand over at steps of a curriculum.)

    Args:
        teacher: See `TaughtBeginning`.
        probability: That it begins an episode.
    """

    whole = False

    def __init__(self, teacher: Policy, probability: float) -> None:
        self._teacher, self._probability = teacher, probability

    def begin(
        self, shape: tuple[int, int, int], evaluation: int, generator: np.random.Generator
    ) -> None:
        """See `Beginning`."""
        self._teacher.reset()
        n, steps, _ = shape
        drawn = generator.integers(0, steps, size=n)
        self._until = np.where(generator.random(n) < self._probability, drawn, 0)
        self._until[:evaluation] = 0

    def act(self, step: int, observations: Array) -> tuple[Array, Chosen]:
        """See `Beginning`.

        Raises:
            PolicyFileError: The teacher's actions are not finite.
        """
        return _taught(self._teacher, observations), step < self._until


def _taught(teacher: Policy, observations: Array) -> Array:
    actions = teacher.act(observations)
    if not np.isfinite(actions).all():
        raise PolicyFileError("the teacher's actions are not finite: it cannot teach")
    return np.clip(actions, -1.0, 1.0)
