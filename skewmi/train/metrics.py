"""How much of the state space has been visited: as published, and soundly.

As published (Skew-Explore and its code), so that curves can be laid beside the paper's:

* entropy: -sum_i p_i log p_i over grid points i, with p the kernel density of 50,000 visited
  states. It lacks the cell area, so it is no entropy of anything: it can exceed log(points).
* coverage: mean over grid points of exp(-d_i^2 / 2 w^2), with d_i the distance to the nearest
  state ever visited. Points inside walls count, so it cannot reach 1.

Sound:

* differential entropy: -mean log p over visited states, each left out of its own density, in
  nats for coordinates in the grid's units. A bound is log(reachable area).
* covered cells: visited fraction of the grid's cells whose center is reachable.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skewmi.batch_env import BatchEnv, TaskMetrics
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.config import MetricsConfig
from skewmi.train.density import kernel_log_density
from skewmi.train.replay import Replay
from skewmi.train.state import State, as_array


def grid_points(low: Array, high: Array, counts: NDArray[np.int64]) -> Array:
    """Regular grid with end points, first axis slowest. Shape (product of counts, axes)."""
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def published_entropy(log_density: Array) -> float:
    """-sum p log p over grid points; 0 where the density underflows."""
    p = np.exp(log_density)
    return float(-np.sum(p[p > 0.0] * log_density[p > 0.0]))


def published_coverage(distance: Array, width: float) -> float:
    """Mean of exp(-d^2 / 2 width^2)."""
    return float(np.mean(np.exp(-0.5 * np.square(distance / width))))


class CoverageMetrics:
    """What a run has visited, on the grid that its task is measured on.

    Args:
        layout: Of the task.
        task: Its grid; without one there are no metrics.
        config: How it is measured.
    """

    def __init__(self, layout: PolicyLayout, task: TaskMetrics, config: MetricsConfig) -> None:
        names = [field.name for field in layout.state_fields]
        unknown = [axis.field for axis in task.grid if axis.field not in names]
        if unknown:
            raise ConfigurationError(
                f"measurement grid uses unknown fields {unknown}; fields are {names}"
            )
        self.config = config
        self.columns = [names.index(axis.field) for axis in task.grid]
        low = np.array([axis.low for axis in task.grid])
        high = np.array([axis.high for axis in task.grid])
        self.counts = np.array([axis.points for axis in task.grid], dtype=np.int64)
        self.offset = low if task.unit_range else np.zeros(len(low))
        self.unit = high - low if task.unit_range else np.ones(len(low))
        self.low, self.high = (low - self.offset) / self.unit, (high - self.offset) / self.unit
        self.points = (
            grid_points(self.low, self.high, self.counts) if self.columns else np.zeros((0, 0))
        )
        self.distance: Array = np.full(len(self.points), np.inf)
        self.visited: NDArray[np.bool_] = np.zeros(len(self.points), dtype=np.bool_)
        self.reachable: NDArray[np.bool_] = np.ones(len(self.points), dtype=np.bool_)

    def set_reachable(self, env: BatchEnv, first_state: Array) -> None:
        """Ask the task which cell centers can be reached, other fields as in `first_state`."""
        if self.columns:
            states = np.repeat(first_state[None], len(self.points), axis=0)
            states[:, self.columns] = self._centers() * self.unit + self.offset
            self.reachable = env.reachable(states)

    def _cell(self) -> Array:
        side: Array = (self.high - self.low) / self.counts
        return side

    def _centers(self) -> Array:
        half: Array = 0.5 * self._cell()
        return grid_points(self.low + half, self.high - half, self.counts)

    def project(self, states: Array) -> Array:
        """Measured fields of states (..., state_dim) in the grid's units."""
        projected: Array = (states[..., self.columns] - self.offset) / self.unit
        return projected

    def add(self, states: Array) -> None:
        """Take in newly visited states (n, state_dim)."""
        if not self.columns:
            return
        x = self.project(states)
        nearest, _ = cKDTree(x).query(self.points)
        self.distance = np.minimum(self.distance, nearest)
        index = np.floor((x - self.low) / self._cell()).astype(np.int64)
        # The upper end belongs to the last cell; a hinge at its stop overshoots it by rounding.
        index = np.where(np.isclose(x, self.high, atol=1e-9), self.counts - 1, index)
        inside = ((index >= 0) & (index < self.counts)).all(1)
        self.visited[np.ravel_multi_index(tuple(index[inside].T), tuple(self.counts))] = True

    def coverage(self) -> dict[str, float]:
        """Both coverages."""
        if not self.columns:
            return {}
        reachable = max(int(self.reachable.sum()), 1)
        return {
            "coverage": published_coverage(self.distance, self.config.coverage_width),
            "covered_cells": float((self.visited & self.reachable).sum() / reachable),
        }

    def entropy(self, history: Replay, generator: np.random.Generator) -> dict[str, float]:
        """Both entropies of everything in the history."""
        if not self.columns:
            return {}
        c = self.config
        x = self.project(history.random_states(c.entropy_points, generator)[0])
        log_density = kernel_log_density(self.points, x, c.entropy_bandwidth)
        own = x[: min(5_000, len(x))]
        left_out = kernel_log_density(own, own, c.entropy_bandwidth, leave_one_out=True)
        # A state with no other one near has density 0 and would make the estimate infinite.
        finite = left_out[np.isfinite(left_out)]
        return {
            "entropy": published_entropy(log_density),
            "differential_entropy": float(-finite.mean()) if len(finite) else float("nan"),
        }

    def state_dict(self) -> State:
        """All that a continuation needs."""
        return {"distance": self.distance, "visited": self.visited}

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`."""
        self.distance = as_array(state["distance"])
        self.visited = as_array(state["visited"]).astype(np.bool_)
