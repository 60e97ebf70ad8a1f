"""Whether a task has been learned: the publication's criterion as it is written, and ours.

Both look at the share of a trajectory's last 10 states that was rewarded, x_i = 0, 0.1, ... 1.

* Published: "90 % of the last 10 states of the last 10 trajectories with a standard deviation
  below 3 %": over the last 10 trajectories, mean(x) >= 90 % and std(x) < 3 %. Since one trajectory
  with 9 of 10 among nine with all has a deviation of 3 % already, this asks for ten trajectories
  that are all alike: next to always, ten in a row that are rewarded to the end.
* Ours: over the last n = 50 trajectories, mean(x) >= 90 %, and that mean is known to a standard
  deviation below 3 %: std(x) / sqrt(n) < 3 %. If trajectories are rewarded to the end or not at
  all, that is 48 of 50.

A policy that succeeds in 7 of 10 episodes has ten successes in a row sooner or later: half of such
policies have met the first criterion within 82 trajectories, of ours 1 in 100 within 2,000.
`docs/skew-explore.md` says more.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array
from skewmi.train.state import State

STATES = 10
"""Last states of a trajectory that are looked at."""
PUBLISHED_TRAJECTORIES = 10
"""Last trajectories that the published criterion looks at."""
_ROUNDING = 1e-9
"""Of shares that are multiples of a tenth: what is at a bound is not below it."""


def last_share(rewards: Array) -> Array:
    """Rewarded share of the last states of trajectories. Shape (n, steps) -> (n,)."""
    share: Array = (rewards[:, -STATES:] > 0.0).mean(1)
    return share


def different(observations: Array) -> NDArray[np.int64]:
    """Which trajectories equal no earlier one: the same again tells nothing new.

    Args:
        observations: Shape (n, steps + 1, observation_dim).

    Returns:
        Indices, ascending. Shape (k,).
    """
    flat = np.ascontiguousarray(observations).reshape(len(observations), -1)
    _, first = np.unique(flat, axis=0, return_index=True)
    return np.sort(first).astype(np.int64)


class Convergence:
    """Both criteria over the trajectories of a run that count.

    Args:
        fraction: Least mean share.
        deviation: What the standard deviation must stay below, see above.
        trajectories: That ours looks at.

    Attributes:
        at: Trajectories of the run when ours held first, or None.
        published_at: Trajectories of the run when the published one held first, or None.
        latest: Mean share of those that were taken in last.
    """

    def __init__(self, fraction: float, deviation: float, trajectories: int) -> None:
        self._fraction, self._deviation, self._count = fraction, deviation, trajectories
        self.shares: deque[float] = deque(maxlen=max(PUBLISHED_TRAJECTORIES, trajectories))
        self.returns: deque[float] = deque(maxlen=PUBLISHED_TRAJECTORIES)
        self.latest = 0.0
        self.at: int | None = None
        self.published_at: int | None = None

    def add(self, observations: Array, rewards: Array, finished: int) -> None:
        """Take in finished trajectories that count.

        Args:
            observations: Shape (n, steps + 1, observation_dim).
            rewards: Shape (n, steps).
            finished: Trajectories of the run so far, these and those that do not count included.
        """
        rewards = rewards[different(observations)]
        shares = last_share(rewards)
        self.shares.extend(shares.tolist())
        self.returns.extend(rewards.sum(1).tolist())
        self.latest = float(shares.mean())
        if self.published and self.published_at is None:
            self.published_at = finished
        if self.converged and self.at is None:
            self.at = finished

    def _last(self, count: int) -> Array:
        return np.array(list(self.shares)[-count:])

    @property
    def fraction(self) -> float:
        """Mean share of the last ten."""
        last = self._last(PUBLISHED_TRAJECTORIES)
        return float(last.mean()) if len(last) else 0.0

    @property
    def score(self) -> tuple[float, float]:
        """Orders policies: the fraction, then the mean return of the same trajectories."""
        return self.fraction, float(np.mean(self.returns)) if self.returns else 0.0

    @property
    def published(self) -> bool:
        """Whether the published criterion holds now."""
        return self._holds(PUBLISHED_TRAJECTORIES, 1.0)

    @property
    def converged(self) -> bool:
        """Whether ours holds now."""
        return self._holds(self._count, math.sqrt(self._count))

    def metrics(self) -> dict[str, float]:
        """What the run's table holds of it: times only of what has happened."""
        times = {
            "trajectories_to_convergence": self.at,
            "trajectories_to_convergence_paper": self.published_at,
        }
        met = {name: float(at) for name, at in times.items() if at is not None}
        return {"evaluation_fraction": self.fraction, **met}

    def _holds(self, count: int, divisor: float) -> bool:
        last = self._last(count)
        if len(last) < count or last.mean() < self._fraction - _ROUNDING:
            return False
        return bool(last.std() / divisor < self._deviation - _ROUNDING)

    def state_dict(self) -> State:
        """All that a continuation needs."""
        return {
            "fractions": list(self.shares),
            "returns": list(self.returns),
            "latest": self.latest,
            "at": self.at,
            "published_at": self.published_at,
        }

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`; what checkpoints of earlier versions lack has not happened."""
        self.shares.clear()
        self.returns.clear()
        self.shares.extend(state["fractions"])
        self.returns.extend(state["returns"])
        self.latest = float(state.get("latest", 0.0))
        self.at, self.published_at = state.get("at"), state.get("published_at")
