"""How much of the state space has been visited: as published, and soundly.

As published (Skew-Explore and its code), so that curves can be laid beside the paper's:

* entropy: -sum_i p_i log p_i over grid points i, with p the kernel density of 50,000 visited
  states. It lacks the cell area, so it is no entropy of anything: it can exceed log(points).
* coverage: mean over grid points of exp(-d_i^2 / 2 w^2), with d_i the distance to the nearest
  state ever visited. Points inside walls count, so it cannot reach 1.
* coverage in own units: the same where a task's axes are scaled to [0, 1], but with d_i in the
  fields' own units, m and rad together. The published code scales for the entropy alone.

Sound:

* differential entropy: -mean log p over visited states drawn without replacement, each left out of
  its own density, in nats for coordinates in the grid's units. log(reachable area) bounds the
  entropy H of the states, but not this estimate, which is the cross-entropy of the states against
  their density smoothed by the kernel, H + KL(states, smoothed): never below H but for chance, and
  above log(area) by what the smoothing loses across walls. `entropy_ceiling` bounds it.
* covered cells: visited fraction of the grid's cells whose center is reachable.
"""

from __future__ import annotations

import math

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

_ENTROPY_STATES = 5_000
"""Visited states behind the differential entropy."""


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


def entropy_ceiling(area: float, axes: int) -> float:
    """What the differential entropy of a region cannot exceed, but for chance and cut-off cells.

    Let the region be covered by N cells whose sides are the bandwidth h, P(c) the share of the
    states in cell c. No two points of a cell are further apart than sqrt(d) h, so the smoothed
    density at a state in c is at least P(c) (2 pi h^2)^(-d/2) exp(-d / 2), and therefore

        -E log p  <=  -sum_c P(c) log P(c) + d/2 log(2 pi h^2) + d/2
                  <=  log(N h^d) + d/2 log(2 pi e).

    Args:
        area: N h^d, in the grid's units.
        axes: d.
    """
    return math.log(area) + 0.5 * axes * math.log(2.0 * math.pi * math.e)


def leave_one_out_entropy(states: Array, bandwidth: float) -> float:
    """-mean log p of distinct draws, each left out of its own kernel density.

    Args:
        states: Shape (n, d).
        bandwidth: Of the kernels, in the states' units.

    Returns:
        In nats; NaN where no state has another one near.
    """
    log_density = kernel_log_density(states, states, bandwidth, leave_one_out=True)
    # A state with no other one near has density 0 and would make the estimate infinite.
    finite = log_density[np.isfinite(log_density)]
    return float(-finite.mean()) if len(finite) else float("nan")


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
        # In the fields' own units, where those are not the grid's.
        self.own_distance: Array | None = self.distance.copy() if task.unit_range else None
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
        if self.own_distance is not None:
            points = self.points * self.unit + self.offset
            nearest, _ = cKDTree(states[..., self.columns]).query(points)
            self.own_distance = np.minimum(self.own_distance, nearest)
        cell = (x - self.low) / self._cell()
        # What is beyond an end by less than half a cell belongs to the last one there: soft stops
        # give way, and what rests on one is a hair beyond it, on either side.
        inside = ((cell > -0.5) & (cell < self.counts + 0.5)).all(1)
        index = np.clip(np.floor(cell).astype(np.int64), 0, self.counts - 1)
        self.visited[np.ravel_multi_index(tuple(index[inside].T), tuple(self.counts))] = True

    def coverage(self) -> dict[str, float]:
        """Those as published, and covered cells."""
        if not self.columns:
            return {}
        reachable = max(int(self.reachable.sum()), 1)
        width = self.config.coverage_width
        metrics = {
            "coverage": published_coverage(self.distance, width),
            "covered_cells": float((self.visited & self.reachable).sum() / reachable),
        }
        if self.own_distance is not None:
            metrics["coverage_own_units"] = published_coverage(self.own_distance, width)
        return metrics

    def entropy(
        self, history: Replay, generator: np.random.Generator, own: np.random.Generator
    ) -> dict[str, float]:
        """Both entropies of everything in the history.

        Args:
            history: Holds what was visited.
            generator: Of the states behind the published one, drawn with replacement as there.
            own: Of those behind the differential one, each drawn once.
        """
        if not self.columns:
            return {}
        c = self.config
        x = self.project(history.random_states(c.entropy_points, generator)[0])
        log_density = kernel_log_density(self.points, x, c.entropy_bandwidth)
        once = self.project(history.distinct_states(_ENTROPY_STATES, own))
        return {
            "entropy": published_entropy(log_density),
            "differential_entropy": leave_one_out_entropy(once, c.entropy_bandwidth),
        }

    def state_dict(self) -> State:
        """All that a continuation needs."""
        own = {} if self.own_distance is None else {"own_distance": self.own_distance}
        return {"distance": self.distance, "visited": self.visited, **own}

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`."""
        self.distance = as_array(state["distance"])
        self.visited = as_array(state["visited"]).astype(np.bool_)
        if self.own_distance is not None and "own_distance" in state:
            self.own_distance = as_array(state["own_distance"])
