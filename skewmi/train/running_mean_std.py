"""Mean and standard deviation of everything seen."""

from __future__ import annotations

import numpy as np

from skewmi.policy_io import Array
from skewmi.train.state import State, as_array


class RunningMeanStd:
    """Mean and variance of everything seen, per field (Chan's parallel update)."""

    def __init__(self, dim: int) -> None:
        self.count = 0.0
        self.mean: Array = np.zeros(dim)
        self.variance: Array = np.ones(dim)

    def update(self, states: Array) -> None:
        """Take in states of shape (n, dim)."""
        n = float(len(states))
        mean, variance = states.mean(0), states.var(0)
        total = self.count + n
        delta = mean - self.mean
        squares = self.variance * self.count + variance * n + delta**2 * self.count * n / total
        self.mean = self.mean + delta * n / total
        self.variance = squares / total
        self.count = total

    def state_dict(self) -> State:
        """All that a continuation needs."""
        return {"count": self.count, "mean": self.mean, "variance": self.variance}

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`."""
        self.count = float(state["count"])
        self.mean, self.variance = as_array(state["mean"]), as_array(state["variance"])
