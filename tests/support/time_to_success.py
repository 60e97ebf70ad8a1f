"""How long a learner took until its policy succeeds, and how two learners compare.

The judge looks at any policy from time to time, by code that is no learner's, and stops the clock
while it looks.
"""

from __future__ import annotations

import resource
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Look = tuple[int, float, float, float]
"""Environment steps, wall-clock and processor seconds of training, and the share of successes."""


def seconds_of_processor() -> float:
    """Of this process and of the programs that it has called, such as a compiler."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def peak_memory_mib() -> dict[str, float]:
    """The most that this process ever had in memory, and the largest program that it called."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    own = next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    called = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    return {"process": round(int(own) / 1024, 1), "largest_called": round(called / 1024, 1)}


class Stopwatch:
    """Wall-clock and processor seconds since it was made, less those inside `paused`."""

    def __init__(
        self,
        wall: Callable[[], float] = time.monotonic,
        processor: Callable[[], float] = seconds_of_processor,
    ) -> None:
        self._clocks = wall, processor
        self._zero = [clock() for clock in self._clocks]

    def read(self) -> tuple[float, float]:
        """Wall-clock and processor seconds."""
        wall, processor = (
            clock() - zero for clock, zero in zip(self._clocks, self._zero, strict=True)
        )
        return wall, processor

    def paused(self, call: Callable[[], float]) -> float:
        """What a call gives, whose time does not count."""
        before = self.read()
        result = call()
        after = self.read()
        self._zero = [z + a - b for z, a, b in zip(self._zero, after, before, strict=True)]
        return result


def share_of_successes(
    act: Callable[[np.ndarray], np.ndarray],
    env: Any,
    target: Sequence[float],
    radius: float,
    seed: int,
) -> float:
    """Share of episodes that come within a distance of a point, all side by side.

    Args:
        act: Observations (n, observation_dim) of the environment to actions (n, action_dim).
        env: A `BatchEnv` whose observations begin with x and y, m.
        target: x and y, m.
        radius: Distance at which a state counts, m, itself included.
        seed: Of the starts: the same ones at every call.
    """
    observation = env.reset(seed)
    met = np.zeros(env.num_envs, dtype=bool)
    for _ in range(env.layout.episode_steps):
        observation = env.step(act(observation)).observation
        offset = observation[:, :2] - np.asarray(target)
        met |= np.sqrt((offset * offset).sum(1)) <= radius
    return float(met.mean())


class Judge:
    """Says when a policy has learned its task: `in_a_row` looks with at least `bar` successes.

    The first look of such a row is when it was learned. Its time is what training took until then.

    Args:
        look: Share of successes of the present policy.
        watch: Started with the training.
        bar: Least share.
        in_a_row: So that one lucky look is not enough.
        limit_s: Wall-clock seconds of training after which it is given up, or None.
        say: Is told every look.

    Attributes:
        curve: Every look.
        solved: That of the first look of the row, or None.
    """

    def __init__(
        self,
        look: Callable[[], float],
        watch: Stopwatch,
        *,
        bar: float = 0.9,
        in_a_row: int = 2,
        limit_s: float | None = None,
        say: Callable[[Look], object] = lambda look: None,
    ) -> None:
        self._look, self._watch, self._say = look, watch, say
        self._bar, self._in_a_row, self._limit_s = bar, in_a_row, limit_s
        self.curve: list[Look] = []
        self.solved: Look | None = None

    def over(self, steps: int) -> bool:
        """Look at the policy after so many environment steps; whether training may end."""
        wall, processor = self._watch.read()
        share = self._watch.paused(self._look)
        self.curve.append((steps, round(wall, 3), round(processor, 3), share))
        self._say(self.curve[-1])
        row = self._row()
        if len(row) >= self._in_a_row:
            self.solved = row[0]
            return True
        if self._limit_s is None or wall < self._limit_s:
            return False
        # What succeeded within the limit may still show that this was no luck.
        return not row or row[0][1] > self._limit_s

    def _row(self) -> list[Look]:
        """The looks since the last one that was not good enough."""
        short = [k for k, (*_, share) in enumerate(self.curve) if share < self._bar]
        return self.curve[short[-1] + 1 if short else 0 :]


def compare(rows: Iterable[dict[str, Any]], ours: str = "ours") -> dict[str, Any]:
    """How many times as long each of the others took as ours, seed by seed, and in the median.

    A run that was given up tells a lower bound: it would have taken at least as long as it had.
    A run of ours that did not get there is no times as fast as anything: it counts as 0.

    Args:
        rows: Finished runs: side, seed, solved, wall_s, processor_s (to the moment when it was
            solved, or all there was), peak_memory_mib.
        ours: The side that the others are compared with.
    """
    by_side: dict[str, dict[int, dict[str, Any]]] = {}
    for row in rows:
        by_side.setdefault(row["side"], {})[row["seed"]] = row
    own = by_side.pop(ours, {})
    sides = {side: _against(own, runs) for side, runs in by_side.items()}
    sides = {side: figures for side, figures in sides.items() if figures["seeds"]}
    if not sides:
        return {"speedup": None, "against": {}}
    best = min(sides, key=lambda side: sides[side]["speedup"])
    return {
        "speedup": sides[best]["speedup"],
        "speedup_is_a_lower_bound": sides[best]["speedup_is_a_lower_bound"],
        "speedup_processor": sides[best]["speedup_processor"],
        "memory_ratio": max(figures["memory_ratio"] for figures in sides.values()),
        "best_of_the_others": best,
        "against": sides,
    }


def _against(own: dict[int, dict[str, Any]], theirs: dict[int, dict[str, Any]]) -> dict[str, Any]:
    """Figures over the seeds that both have run."""
    pairs = [(own[seed], theirs[seed]) for seed in sorted(own.keys() & theirs.keys())]
    if not pairs:
        return {"seeds": 0}
    each = [
        {
            "seed": one["seed"],
            "speedup": _times(one, other, "wall_s"),
            "speedup_processor": _times(one, other, "processor_s"),
            "lower_bound": bool(one["solved"]) and not other["solved"],
        }
        for one, other in pairs
    ]
    memory = [
        one["peak_memory_mib"]["process"] / other["peak_memory_mib"]["process"]
        for one, other in pairs
    ]
    speedup = statistics.median(row["speedup"] for row in each)
    return {
        "seeds": len(each),
        "solved": sum(bool(other["solved"]) for _, other in pairs),
        "ours_solved": sum(bool(one["solved"]) for one, _ in pairs),
        "speedup": speedup,
        # Where a bound lies at the median or below it, the true median may be above.
        "speedup_is_a_lower_bound": any(
            row["lower_bound"] and row["speedup"] <= speedup for row in each
        ),
        "speedup_processor": statistics.median(row["speedup_processor"] for row in each),
        "memory_ratio": round(statistics.median(memory), 3),
        "each": each,
    }


def _times(one: dict[str, Any], other: dict[str, Any], clock: str) -> float:
    return round(other[clock] / one[clock], 2) if one["solved"] else 0.0
