"""First times of things."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skewmi.batch_env import Event
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.state import State

REWARD_EVENT = "reward"
"""Name of the event that every run has: the first extrinsic reward."""


class Discoveries:
    """Trajectory and step number of each event's first time."""

    def __init__(self, layout: PolicyLayout, events: tuple[Event, ...]) -> None:
        names = layout.observation_names
        for event in events:
            unknown = [c.field for c in event.conditions if c.field not in names]
            if unknown:
                raise ConfigurationError(
                    f"event {event.name!r} uses unknown fields {unknown}; fields are {list(names)}"
                )
        self._events = events
        self._names = names
        self.first: dict[str, dict[str, int]] = {}

    @property
    def names(self) -> tuple[str, ...]:
        return (*(event.name for event in self._events), REWARD_EVENT)

    def add(self, observations: Array, rewards: Array, episodes: int, steps: int) -> list[str]:
        """Look through finished episodes.

        Args:
            observations: After each step. Shape (n, steps, observation_dim).
            rewards: Shape (n, steps).
            episodes: Finished before these.
            steps: Environment steps before these.

        Returns:
            Names of the events met for the first time.
        """
        new = []
        for name in self.names:
            if name in self.first:
                continue
            met = rewards > 0.0 if name == REWARD_EVENT else self._met(name, observations)
            if met.any():
                # Environments run side by side: the earliest step counts.
                column = int(np.argmax(met.any(0)))
                row = int(np.argmax(met[:, column]))
                self.first[name] = {
                    "trajectory": episodes + row + 1,
                    "step": steps + (column + 1) * len(met),
                }
                new.append(name)
        return new

    def state_dict(self) -> State:
        """All that a continuation needs."""
        return dict(self.first)

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`."""
        self.first = dict(state)

    def _met(self, name: str, observations: Array) -> NDArray[np.bool_]:
        event = next(event for event in self._events if event.name == name)
        met = np.ones(observations.shape[:-1], dtype=np.bool_)
        for c in event.conditions:
            value = observations[..., self._names.index(c.field)]
            if c.low is not None:
                met &= value >= c.low
            if c.high is not None:
                met &= value <= c.high
        return met
