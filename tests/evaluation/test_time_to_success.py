"""When a learner counts as done, what that took, and how two are compared."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from time_to_success import Judge, Stopwatch, compare, peak_memory_mib, share_of_successes

from skewmi.sim import tasks


class Clock:
    """Seconds that pass when a test says so."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def judged(
    shares: list[float], each_s: float = 10.0, look_s: float = 3.0, limit_s: float | None = None
) -> tuple[Judge, int]:
    """A judge that has seen shares one after another, and at how many looks it was over."""
    clock = Clock()
    left: Iterator[float] = iter(shares)

    def look() -> float:
        clock.now += look_s
        return next(left)

    judge = Judge(look, Stopwatch(clock, clock), limit_s=limit_s)
    for k in range(len(shares)):
        clock.now += each_s
        if judge.over(1000 * (k + 1)):
            return judge, k + 1
    return judge, 0


@given(st.lists(st.sampled_from((0.0, 0.5, 0.85, 0.9, 0.95, 1.0)), min_size=1, max_size=30))
def test_solved_at_the_first_two_good_looks_in_a_row(shares: list[float]) -> None:
    pairs = [k for k in range(len(shares) - 1) if min(shares[k : k + 2]) >= 0.9]
    judge, over = judged(shares)
    if not pairs:
        assert (judge.solved, over) == (None, 0)
        return
    first = pairs[0]
    assert over == first + 2
    # The looks themselves, 3 s each, count for nobody.
    time = pytest.approx(10.0 * (first + 1))
    assert judge.solved == (1000 * (first + 1), time, time, shares[first])


@given(st.lists(st.sampled_from((0.0, 0.9)), min_size=8, max_size=8), st.integers(5, 60))
def test_given_up_at_the_limit_but_not_before_a_success_is_confirmed(
    shares: list[float], limit: int
) -> None:
    judge, over = judged(shares, limit_s=float(limit))
    last = math.ceil(limit / 10)  # the first look at or after the limit
    if judge.solved is not None:
        assert judge.solved[1] <= limit
        assert over <= last + 1
    else:
        confirming = shares[last - 1] == 0.9 and 10 * last <= limit
        assert over == (last + 1 if confirming else last)


class Straight:
    """Goes in one direction, from where the task starts."""

    def __init__(self, direction: tuple[float, float]) -> None:
        self.direction = direction

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        return np.tile(self.direction, (len(observation), 1))


@pytest.mark.parametrize(
    ("direction", "target", "radius", "share"),
    [
        ((0.0, 1.0), (0.0, 4.0), 0.15, 1.0),  # passes it on its way
        ((0.0, -1.0), (0.0, 4.0), 0.15, 0.0),
        ((0.0, 1.0), (0.0, 7.0), 1.9, 0.0),  # the wall is before it
        ((0.0, 0.0), (0.0, 0.0), 0.15, 1.0),
        ((0.0, 0.0), (3.0, 4.0), 5.0, 1.0),  # at the bound itself
        ((0.0, 0.0), (3.0, 4.0), 4.99, 0.0),
    ],
)
def test_an_episode_succeeds_that_comes_near(
    direction: tuple[float, float], target: tuple[float, float], radius: float, share: float
) -> None:
    env: Any = tasks.make_batch("point_maze", 4, num_threads=1)
    assert share_of_successes(Straight(direction), env, target, radius, seed=3) == share


def test_starts_are_spread_and_the_same_at_every_look() -> None:
    env: Any = tasks.make_batch("point_maze", 40, num_threads=1, start_noise=0.3)
    shares = [
        share_of_successes(Straight((0.0, 0.0)), env, (0.0, 0.0), 0.2, seed) for seed in (5, 5, 6)
    ]
    assert 0.0 < shares[0] < 1.0
    assert shares[0] == shares[1]
    env.reset(5)
    expected = (np.linalg.norm(env.position, axis=1) <= 0.2).mean()
    assert shares[0] == expected


def row(side: str, seed: int, wall: float, solved: bool = True, memory: float = 100.0) -> dict:
    return {
        "side": side, "seed": seed, "solved": solved, "wall_s": wall, "processor_s": wall / 2,
        "peak_memory_mib": {"process": memory},
    }  # fmt: skip


def test_the_best_of_the_others_counts_and_bounds_stay_bounds() -> None:
    ours = [row("ours", seed, wall, memory=50.0) for seed, wall in enumerate((10.0, 20.0, 10.0))]
    never = [row("never", seed, 10 * one["wall_s"], False) for seed, one in enumerate(ours)]
    slow = [row("slow", seed, wall) for seed, wall in enumerate((40.0, 120.0, 30.0))]
    both = compare([*ours, *never, *slow])
    assert (both["best_of_the_others"], both["speedup"]) == ("slow", 4.0)
    assert not both["speedup_is_a_lower_bound"]
    assert both["memory_ratio"] == 0.5
    assert both["against"]["never"]["solved"] == 0
    alone = compare([*ours, *never])
    assert (alone["speedup"], alone["speedup_is_a_lower_bound"]) == (10.0, True)
    assert alone["speedup_processor"] == 10.0
    # Seeds that only one side has run say nothing.
    assert compare([*ours, *slow[:1]])["against"]["slow"]["seeds"] == 1
    assert compare(ours) == {"speedup": None, "against": {}}


def test_a_run_of_ours_that_fails_is_not_left_out() -> None:
    ours = [row("ours", 0, 10.0), row("ours", 1, 10.0, False), row("ours", 2, 10.0, False)]
    theirs = [row("peer", seed, 100.0, solved=False) for seed in range(3)]
    figures = compare([*ours, *theirs])
    assert (figures["speedup"], figures["speedup_is_a_lower_bound"]) == (0.0, False)
    assert figures["against"]["peer"]["ours_solved"] == 1


def test_peak_memory_is_kept() -> None:
    before = peak_memory_mib()["process"]
    grown = np.ones(8 << 20)  # 64 MiB
    del grown
    after = peak_memory_mib()["process"]
    assert after >= before > 1.0
