"""In which unit rewards are learned from: the deviation of what they add up to."""

from __future__ import annotations

import numpy as np

from skewmi.policy_io import Array
from skewmi.train.running_mean_std import RunningMeanStd
from skewmi.train.state import State

_SMALLEST = 1e-8
"""Deviation below which rewards are taken to be constant, and as they are."""


def discounted_sums(rewards: Array, discount: float) -> Array:
    """sum_{k <= t} discount^(t - k) r_k at every step t of whole episodes. Shape (n, steps)."""
    result = np.empty_like(rewards)
    so_far = np.zeros(len(rewards))
    for t in range(rewards.shape[1]):
        so_far = discount * so_far + rewards[:, t]
        result[:, t] = so_far
    return result


class ReturnScale:
    """Running standard deviation of the discounted sums of rewards.

    A network that has to follow sums of 0.1 here and of 200 there needs another learning rate
    each time; in units of their deviation it does not.

    Args:
        discount: Per step.
    """

    def __init__(self, discount: float) -> None:
        self.discount = discount
        self._running = RunningMeanStd(1)

    @property
    def deviation(self) -> float:
        """Of everything seen; 1 before anything was, and where nothing ever changed."""
        deviation = float(np.sqrt(self._running.variance[0]))
        return deviation if deviation > _SMALLEST else 1.0

    def update(self, rewards: Array) -> None:
        """Take in the rewards of whole episodes, shape (n, steps)."""
        self._running.update(discounted_sums(rewards, self.discount).reshape(-1, 1))

    def state_dict(self) -> State:
        """All that a continuation needs."""
        return self._running.state_dict()

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`."""
        self._running.load_state_dict(state)
