"""How long runs still take, by hand."""

from __future__ import annotations

from dataclasses import replace

import pytest

from skewmi.sweep.driver import State, Tracked
from skewmi.sweep.estimate import Estimate, in_words
from skewmi.sweep.plan import Run
from skewmi.sweep.run_folder import Progress
from skewmi.train.presets import default_preset


def tracked(preset: str, steps: int, seconds: float, state: State = State.WAITING) -> Tracked:
    config = replace(default_preset("t"), preset=preset, total_steps=100)
    return Tracked(Run("r", config, {}), state, Progress(steps, seconds))


def test_a_run_takes_as_long_as_it_has_or_as_its_like_did() -> None:
    runs = [
        tracked("a", 100, 50.0, State.DONE),
        tracked("a", 20, 20.0, State.RUNNING),
        tracked("a", 0, 0.0),
        tracked("b", 0, 0.0),
    ]
    estimate = Estimate(runs)
    # Half a second a step and a second a step: in the mean three quarters.
    assert [estimate.left(r) for r in runs] == [0.0, 80.0, 75.0, None]
    assert estimate.in_all(1) == pytest.approx(80 + 75 + 75)
    assert estimate.in_all(2) == pytest.approx(115)
    assert estimate.in_all(99) == 80.0


def test_nothing_is_known_before_the_first_row() -> None:
    assert Estimate([tracked("a", 0, 0.0)]).in_all(1) is None


def test_durations_in_words() -> None:
    assert [in_words(s) for s in (None, 5.0, 100.0, 7200.0)] == [
        "unknown", "5 s", "2 min", "2.0 h",
    ]  # fmt: skip
