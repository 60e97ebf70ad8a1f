"""From the first reward until it has converged, a run may learn more than before and after."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from skewmi.errors import ConfigurationError
from skewmi.train.runner import Runner
from skewmi.train.sac.config import SacConfig

STEPS = 400


@pytest.fixture
def runner(make_corridor, corridor_config) -> Runner:
    learner = replace(
        corridor_config.learner,
        updates_per_step=0.01,
        burst_updates_per_step=0.05,
        rewarded_fraction=0.25,
        burst_rewarded_fraction=0.5,
        rare_fraction=0.0,
    )
    rollout = replace(corridor_config.rollout, random_steps=0)
    made = Runner(replace(corridor_config, learner=learner, rollout=rollout), make_corridor())
    made.iterate()
    return made


@pytest.mark.parametrize(
    ("hurry", "per_step", "rewarded"), [(False, 0.01, 0.25), (True, 0.05, 0.5)]
)
def test_learner_in_a_hurry_learns_more_of_rewards(
    runner: Runner, hurry: bool, per_step: float, rewarded: float
) -> None:
    learner, fractions = runner.learner, []
    draw = runner.history.draw
    runner.history.draw = lambda *a, **k: (fractions.append(a[2]), draw(*a, **k))[1]  # type: ignore[method-assign]
    learner._owed = 0.0
    learner.hurry, before = hurry, learner.updates
    new = SimpleNamespace(episodes=SimpleNamespace(rewards=np.zeros((4, STEPS // 4))))
    learner.observe(new, np.zeros((4, STEPS // 4)))
    learner.update(runner.history, runner.exploration, runner.generator)
    assert learner.updates - before == round(per_step * STEPS)
    assert set(fractions) == {rewarded}


def test_runner_hurries_between_first_reward_and_convergence(runner: Runner) -> None:
    told: list[bool] = []
    observe = runner.learner.observe

    def watched(rollout, term) -> None:
        told.append(runner.learner.hurry)
        observe(rollout, term)

    runner.learner.observe = watched  # type: ignore[method-assign]
    for rewarded, converged in ((3, None), (3, 20), (7, None)):
        runner.rewarded_episodes, runner.convergence.at = rewarded, converged
        runner.iterate()
    assert told == [True, False, True]
    runner.rewarded_episodes, runner.convergence.at = 0, None
    runner.iterate()
    assert told[-1] == (runner.rewarded_episodes > 0)


def test_no_burst_unless_asked_for() -> None:
    plain = SacConfig()
    assert plain.burst_updates_per_step is None
    assert plain.burst_rewarded_fraction is None
    for wrong in (-0.1, 0.9):
        with pytest.raises(ConfigurationError, match="burst_rewarded_fraction"):
            SacConfig(burst_rewarded_fraction=wrong)
