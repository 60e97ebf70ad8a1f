"""Exploration without a target: nothing is paid, and every refresh is measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tiny_methods import CountBonus, CountBonusConfig
from train_runs import resumes_alike

from skewmi.errors import ConfigurationError
from skewmi.policy_io import Ball
from skewmi.train.checkpoint import read_checkpoint
from skewmi.train.config import TrainConfig
from skewmi.train.history import visited_states
from skewmi.train.log import read_metrics
from skewmi.train.registry import EXPLORATIONS, Entry
from skewmi.train.run import run_train


@pytest.fixture
def unrewarded(corridor_config: TrainConfig) -> TrainConfig:
    """Goals are proposed anew in every second iteration; a rewarded run measures every fourth."""
    exploration = replace(corridor_config.exploration, refresh_steps=400, first_refresh_steps=200)
    metrics = replace(corridor_config.metrics, every_steps=800)
    return replace(
        corridor_config, rewarded=False, exploration=exploration, metrics=metrics, total_steps=1200
    )


def everywhere(make_corridor):
    """The corridor, rewarded wherever one stands."""

    def make():
        env = make_corridor()
        env.layout = replace(env.layout, reward_region=(Ball(("x",), (2.0,), 2.0),))
        return env

    return make


def test_nothing_is_paid_and_every_refresh_is_measured(tmp_path, make_corridor, unrewarded) -> None:
    whole = resumes_alike(unrewarded, everywhere(make_corridor), tmp_path, 600)
    table = read_metrics(whole)
    assert table["refresh"] == [1.0, 1.0, 2.0, 2.0, 3.0, 3.0]
    for name in ("entropy", "differential_entropy"):
        assert np.isfinite(table[name]).tolist() == [True, False] * 3
    assert np.isfinite(table["coverage"]).all()
    assert np.diff(table["covered_cells"]).min() >= 0.0
    for name in ("return", "rewarded_fraction", "rewarded_episodes", "evaluation_fraction"):
        assert not any(table[name]), name
    assert np.isnan(table["trajectories_to_convergence_paper"]).all()
    state = read_checkpoint(whole).state
    assert state["converged_at"] is state["converged_at_paper"] is None
    assert state["discoveries"].keys() <= {"right side"}
    assert not visited_states(whole)[1].any()


def test_it_is_what_a_run_in_a_world_without_reward_would_be(
    tmp_path, make_corridor, unrewarded
) -> None:
    """Nothing of the target gets through: not by its reward, and not by its region."""

    nowhere = make_corridor()
    nowhere.compute_reward = lambda state: np.zeros(state.shape[:-1])
    # Both measured at the same steps: measuring draws random numbers, too.
    metrics = replace(unrewarded.metrics, every_steps=400)
    config = replace(unrewarded, total_steps=1000, metrics=metrics)
    run_train(config, everywhere(make_corridor)(), tmp_path / "one", progress=False)
    run_train(replace(config, rewarded=True), nowhere, tmp_path / "other", progress=False)
    one, other = (visited_states(tmp_path / name)[0] for name in ("one", "other"))
    np.testing.assert_array_equal(one, other)


def test_any_exploration_can_be_measured(
    tmp_path, make_corridor, unrewarded, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(EXPLORATIONS, "count-bonus", Entry(CountBonusConfig, CountBonus))
    config = replace(unrewarded, exploration=CountBonusConfig(), total_steps=600)
    run_train(config, make_corridor(), tmp_path, progress=False)
    table = read_metrics(tmp_path)
    assert table["refresh"] == [1.0, 2.0, 3.0]  # its cells are counted anew every time
    assert np.isfinite(table["entropy"]).all()


def test_nothing_can_converge_without_a_reward(unrewarded) -> None:
    with pytest.raises(ConfigurationError, match=r"stop_on_convergence.*unrewarded"):
        replace(unrewarded, stop_on_convergence=True)


def test_a_rewarded_run_can_begin_with_an_unrewarded_one(
    tmp_path, make_corridor, unrewarded
) -> None:
    """First explore, then be told what pays."""
    make = everywhere(make_corridor)
    run_train(replace(unrewarded, total_steps=400), make(), tmp_path / "explored", progress=False)
    config = replace(unrewarded, rewarded=True, total_steps=800)
    run_dir = tmp_path / "told"
    run_train(config, make(), run_dir, start_from=tmp_path / "explored", progress=False)
    assert read_metrics(run_dir)["return"] == [40.0, 40.0]
    assert read_checkpoint(run_dir).state["refreshes"] == 2
