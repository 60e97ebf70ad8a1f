"""What the runner asks of a learner. `registry.LEARNERS` has one line for each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from torch import Tensor, nn

from skewmi.policy_io import Array
from skewmi.train.checks import require_finite
from skewmi.train.exploration.protocol import Exploration
from skewmi.train.replay import Episodes, Replay
from skewmi.train.state import State

Hidden = tuple[Tensor, ...]
"""Memory of a recurrent policy, one row per environment; empty for a policy without memory."""


@dataclass(frozen=True)
class LearnerConfig:
    """The numbers of a learner; each learner derives its own."""

    def __post_init__(self) -> None:
        require_finite(self)


@dataclass(frozen=True)
class Decision:
    """What a learner does at one step of all environments.

    Attributes:
        action: In [-1, 1]. Shape (n, action_dim).
        hidden: What to pass at the next step of these episodes.
        notes: What the learner wants back with these steps, say log densities of the actions or
            the hidden state before them: name -> shape (n, ...).
    """

    action: Array
    hidden: Hidden = ()
    notes: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Rollout:
    """One finished episode of every environment.

    Attributes:
        episodes: What happened. n episodes.
        evaluation: The first so many ran the deterministic policy towards the evaluation goal.
        notes: `Decision.notes` of every step: name -> shape (n, steps, ...). Empty where actions
            were drawn at random instead.
    """

    episodes: Episodes
    evaluation: int
    notes: Mapping[str, Array]


class Learner(Protocol):
    """Turns episodes into a policy pi(a | s, z) for states s and goals z.

    An iteration of the runner calls `act` at every step, then `observe` once, then `update` once.
    A learner constructs itself from its configuration, the layout of the task, the size of a goal
    (0: this exploration has none), a seed and a device, and draws its noise from a stream of its
    own, so that it does not matter when others draw.
    """

    hurry: bool
    """Set by the runner before `observe`: rewards have been met, and the run has not converged."""

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of what `update` returns, in the order of their columns."""

    @property
    def updates(self) -> int:
        """Gradient updates so far."""

    @property
    def on_policy(self) -> bool:
        """Whether every action has to be its own: then nothing random replaces any."""

    def act(
        self, observations: Array, goals: Array, hidden: Hidden | None, evaluation: int
    ) -> Decision:
        """Actions of one step.

        Args:
            observations: Shape (n, observation_dim).
            goals: Shape (n, goal_dim).
            hidden: Of the step before; None at the first step of episodes.
            evaluation: The first so many rows act deterministically.
        """

    def observe(self, rollout: Rollout, trajectory_term: Array) -> None:
        """Take in finished episodes, which are in the history already.

        Args:
            rollout: As collected.
            trajectory_term: What the exploration stored with them. Shape (n, steps).
        """

    def update(
        self, history: Replay, exploration: Exploration, generator: np.random.Generator
    ) -> dict[str, float]:
        """Learn as much as the episodes observed since the last time allow.

        Args:
            history: All episodes, the latest included.
            exploration: Gives intrinsic rewards and present goals.
            generator: Of the choice of transitions; shared with the rest of the run.

        Returns:
            Some of `metrics`, means over the updates made; empty if there were none.
        """

    def policy_module(self, goal: Array) -> nn.Module:
        """The deterministic policy towards one goal, as `export.exportable` describes it.

        Args:
            goal: In the task's units. Shape (goal_dim,).
        """

    def state_dict(self) -> State:
        """All that an identical continuation needs.

        Its random stream is named `generator`: another run that begins with this state (but does
        not continue it) has one of its own there.
        """

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`.

        Raises:
            CheckpointError: It is of other networks.
            KeyError, ValueError, TypeError: It is damaged.
        """
