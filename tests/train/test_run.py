"""Whole runs on a tiny task: resuming, being killed, refusing, and that skewing helps."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from skewmi.errors import CheckpointError, ConfigurationError, LayoutMismatchError, NotFoundError
from skewmi.policy_io import Ball
from skewmi.train import checkpoint as checkpoints
from skewmi.train.checkpoint import load_policy, read_checkpoint, read_run_header
from skewmi.train.config import Condition, Event, TrainConfig
from skewmi.train.inputs import InputNormalizer
from skewmi.train.log import read_metrics
from skewmi.train.milestones import Convergence, Discoveries
from skewmi.train.presets import PRESETS, preset
from skewmi.train.rollout import GoalSource, plan_goals
from skewmi.train.run import TIME_COLUMNS, run_train
from skewmi.train.sac.sac import Sac


def same_table(one: Path, other: Path) -> None:
    a, b = read_metrics(one), read_metrics(other)
    assert a.keys() == b.keys()
    for name in a.keys() - set(TIME_COLUMNS):
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def same_checkpoint(one: Path, other: Path) -> None:
    a, b = read_checkpoint(one), read_checkpoint(other)
    assert a.state == b.state
    assert a.tensors.keys() == b.tensors.keys()
    for name, tensor in a.tensors.items():
        assert torch.equal(tensor, b.tensors[name]), name
    blocks = sorted(p.name for p in (a.path / "replay").iterdir())
    assert blocks == sorted(p.name for p in (b.path / "replay").iterdir())
    for name in blocks:
        ours = np.load(a.path / "replay" / name)
        # The ring has overwritten part of some blocks; the live rows are compared.
        first = max(0, a.state["episodes"] - 20 - int(name.split("-")[1]))
        np.testing.assert_array_equal(ours[first:], np.load(b.path / "replay" / name)[first:])


def test_resumed_run_is_the_uninterrupted_one(tmp_path, make_corridor, corridor_config) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    run_train(corridor_config, make_corridor(), whole, progress=False)
    half = replace(corridor_config, total_steps=corridor_config.total_steps // 2)
    run_train(half, make_corridor(), parts, progress=False)
    result = run_train(corridor_config, make_corridor(), parts, resume=True, progress=False)
    assert result.stopped_by == "steps"
    assert result.steps == corridor_config.total_steps
    same_table(whole, parts)
    same_checkpoint(whole, parts)


def test_rows_after_the_checkpoint_are_dropped(tmp_path, make_corridor, corridor_config) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    run_train(corridor_config, make_corridor(), whole, progress=False)
    half = replace(corridor_config, total_steps=600)
    run_train(half, make_corridor(), killed, progress=False)
    # As after a kill between writing the row and the checkpoint, and in the middle of a row.
    with (killed / "metrics.csv").open("a") as file:
        file.write("800,20,99,0" + ",0" * 17 + "\n1000,2")
    run_train(corridor_config, make_corridor(), killed, resume=True, progress=False)
    same_table(whole, killed)


def test_kill_while_writing_a_checkpoint(
    tmp_path, make_corridor, corridor_config, monkeypatch
) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    run_train(corridor_config, make_corridor(), whole, progress=False)
    half = replace(corridor_config, total_steps=600)
    run_train(half, make_corridor(), killed, progress=False)
    before = read_checkpoint(killed).path

    def die(*_: object) -> None:
        raise KeyboardInterrupt

    # Dies when everything is written but not yet in its place.
    monkeypatch.setattr(checkpoints.os, "replace", die)
    env, config = make_corridor(), replace(corridor_config, total_steps=800)
    with pytest.raises(KeyboardInterrupt):
        checkpoints.write_checkpoint(killed, 800, {"x": torch.zeros(1)}, {"step": 800}, None)
    monkeypatch.undo()
    assert read_checkpoint(killed).path == before
    assert any(p.name.startswith(".writing") for p in before.parent.iterdir())
    run_train(config, env, killed, resume=True, progress=False)
    run_train(corridor_config, make_corridor(), killed, resume=True, progress=False)
    same_table(whole, killed)
    same_checkpoint(whole, killed)


_CHILD = """
import sys, dataclasses, importlib.util
spec = importlib.util.spec_from_file_location("corridor_conftest", sys.argv[1])
m = importlib.util.module_from_spec(spec); spec.loader.exec_module(m)
from pathlib import Path
from skewmi.policy_io import Ball
from skewmi.train.config import Condition, Event, TrainConfig
from skewmi.train.run import run_train
config = TrainConfig.from_json(Path(sys.argv[2]).read_text())
run_train(config, m.Corridor(), Path(sys.argv[3]), resume=True, progress=False)
"""


def test_kill_minus_nine(tmp_path, make_corridor, corridor_config) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    config = replace(corridor_config, total_steps=4000)
    run_train(config, make_corridor(), whole, progress=False)
    (tmp_path / "config.json").write_text(replace(config, total_steps=10**9).to_json())
    arguments = [sys.executable, "-c", _CHILD, str(Path(__file__).with_name("conftest.py"))]
    arguments += [str(tmp_path / "config.json"), str(killed)]
    child = subprocess.Popen(arguments, env={**os.environ, "OMP_NUM_THREADS": "1"})
    try:
        steps = 0
        while steps < 1000:
            assert child.poll() is None, "the run ended by itself"
            time.sleep(0.02)
            names = [p.name for p in (killed / "checkpoints").glob("[0-9]*")]
            steps = max(map(int, names), default=0)
    finally:
        child.send_signal(signal.SIGKILL)
        child.wait()
    at = read_checkpoint(killed).state["step"]
    if at > config.total_steps:  # a slow test machine let it run on: compare there
        whole = tmp_path / "longer"
        config = replace(config, total_steps=at)
        run_train(config, make_corridor(), whole, progress=False)
    run_train(config, make_corridor(), killed, resume=True, progress=False)
    same_table(whole, killed)
    same_checkpoint(whole, killed)


def test_no_pickle_in_a_run(tmp_path, make_corridor, corridor_config) -> None:
    run_train(replace(corridor_config, total_steps=400), make_corridor(), tmp_path, progress=False)
    files = [p for p in tmp_path.rglob("*") if p.is_file()]
    kinds = {p.suffix for p in files if p.parent.name != "tb"}
    assert kinds == {".json", ".csv", ".safetensors", ".npy"}
    for path in files:
        if path.suffix == ".npy":
            np.load(path, allow_pickle=False, mmap_mode="r")


def test_policy_of_a_run(tmp_path, make_corridor, corridor_config) -> None:
    env = make_corridor()
    run_train(corridor_config, env, tmp_path, progress=False)
    policy = load_policy(tmp_path)
    assert policy.layout == env.layout
    state = read_checkpoint(tmp_path)
    np.testing.assert_array_equal(policy.goal, state.state["evaluation_goal"])
    observation = np.random.default_rng(0).uniform(0, 4, size=(3, 7, 3))
    action = policy.act(observation)
    assert action.shape == (3, 7, 2)
    assert np.abs(action).max() <= 1.0
    np.testing.assert_allclose(policy.act(observation[1, 2]), action[1, 2], atol=1e-6)
    # The very action that training's evaluation episodes take.
    inputs = InputNormalizer(env.layout, True)
    sac = Sac(corridor_config.sac, inputs.dim, 2, seed=0)
    sac.load_state_tensors({k: v for k, v in state.tensors.items() if not k.startswith("trainer.")})
    flat = observation.reshape(-1, 3)
    x = inputs(flat, np.broadcast_to(policy.goal, (len(flat), 2)))
    expected = sac.act(x, deterministic=True).numpy()
    np.testing.assert_allclose(action.reshape(-1, 2), expected, atol=1e-6)
    with pytest.raises(LayoutMismatchError, match="2 fields"):
        policy.act(np.zeros((4, 2)))
    assert json.loads(json.dumps(policy.metadata))["task"] == "corridor"


def test_another_layout_is_refused(tmp_path, make_corridor, corridor_config) -> None:
    half = replace(corridor_config, total_steps=400)
    run_train(half, make_corridor(), tmp_path, progress=False)
    with pytest.raises(LayoutMismatchError, match="another layout"):
        run_train(half, make_corridor(field_high=5.0), tmp_path, resume=True, progress=False)


def test_another_configuration_is_refused(tmp_path, make_corridor, corridor_config) -> None:
    half = replace(corridor_config, total_steps=400)
    run_train(half, make_corridor(), tmp_path, progress=False)
    other = replace(half, skew=replace(half.skew, sigma=9.0))
    with pytest.raises(ConfigurationError, match="another skew"):
        run_train(other, make_corridor(), tmp_path, resume=True, progress=False)
    with pytest.raises(ConfigurationError, match="--resume"):
        run_train(half, make_corridor(), tmp_path, progress=False)


@pytest.mark.parametrize("name", ["weights.safetensors", "state.json"])
def test_damaged_checkpoint_is_refused(tmp_path, make_corridor, corridor_config, name: str) -> None:
    run_train(replace(corridor_config, total_steps=400), make_corridor(), tmp_path, progress=False)
    file = read_checkpoint(tmp_path).path / name
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(CheckpointError, match="damaged"):
        load_policy(tmp_path)


def test_no_run_is_said_so(tmp_path) -> None:
    with pytest.raises(CheckpointError, match="no run directory"):
        load_policy(tmp_path)
    (tmp_path / "config.json").write_text("{}")
    with pytest.raises(CheckpointError, match="damaged"):
        read_run_header(tmp_path)


def test_number_of_environments_must_agree(tmp_path, make_corridor, corridor_config) -> None:
    with pytest.raises(ConfigurationError, match="7 copies"):
        run_train(corridor_config, make_corridor(7), tmp_path, progress=False)


@pytest.mark.parametrize("task", ["point_maze", "open_press_close"])
@pytest.mark.parametrize("name", PRESETS)
def test_configurations_survive_json(task: str, name: str) -> None:
    config = preset(task, name)
    assert TrainConfig.from_json(config.to_json()) == config


def test_unknown_preset_lists_those_there_are() -> None:
    with pytest.raises(NotFoundError, match="point_maze/paper"):
        preset("point_maze", "best")


def test_convergence_is_the_published_criterion() -> None:
    convergence = Convergence(0.9, 0.03)
    good, bad = np.ones((1, 200)), np.ones((1, 200))
    bad[:, -2:] = 0.0  # 8 of its last 10 states are rewarded
    for _ in range(9):
        convergence.add(good)
        assert not convergence.converged  # fewer than ten trajectories
    convergence.add(bad)
    assert convergence.fraction == pytest.approx(0.98)
    for _ in range(6):
        convergence.add(bad)
    assert convergence.fraction == pytest.approx(0.86)
    assert not convergence.converged


def test_first_times_are_the_first(make_corridor, corridor_config) -> None:
    layout = make_corridor().layout
    found = Discoveries(layout, corridor_config.metrics.events)
    observations, rewards = np.zeros((4, 40, 3)), np.zeros((4, 40))
    assert found.add(observations, rewards, 0, 0) == []
    observations[1, 30:, 0] = 3.0
    observations[3, 7, 0] = 3.0  # the earliest step, though not the first row
    assert found.add(observations, rewards, 4, 160) == ["right side"]
    assert found.first["right side"] == {"trajectory": 4 + 3 + 1, "step": 160 + 8 * 4}
    rewards[0, 5] = 1.0
    assert found.add(observations, rewards, 8, 320) == ["reward"]
    assert found.first["right side"]["trajectory"] == 8


def test_event_of_an_unknown_field_is_refused(make_corridor) -> None:
    event = Event("lid", (Condition("lid_angle", low=0.5),))
    with pytest.raises(ConfigurationError, match="lid_angle"):
        Discoveries(make_corridor().layout, (event,))


def test_best_checkpoint_is_the_best_evaluated(tmp_path, make_corridor, corridor_config) -> None:
    # Every state is rewarded where x < 4, so that evaluation succeeds at once.
    env = make_corridor()
    everywhere = replace(env.layout, reward_region=(Ball(("x",), (2.0,), 2.0),))
    env.layout = everywhere
    result = run_train(corridor_config, env, tmp_path, progress=False)
    assert result.evaluation_fraction == 1.0
    # One evaluated trajectory per iteration of five.
    assert result.converged_at is None  # six iterations, the criterion wants ten
    best, latest = read_checkpoint(tmp_path, "best"), read_checkpoint(tmp_path)
    assert best.path.name.startswith("best-")
    assert best.state["best_score"] == [1.0, 40.0]
    assert best.state["step"] <= latest.state["step"]
    assert load_policy(tmp_path, "best").metadata["evaluation_fraction"] == 1.0
    longer = replace(corridor_config, total_steps=4000, stop_on_convergence=True)
    result = run_train(longer, env, tmp_path, resume=True, progress=False)
    assert result.stopped_by == "convergence"
    assert result.converged_at == 50


def test_goals_switch_at_the_asked_rate() -> None:
    rng = np.random.default_rng(0)
    proposals = rng.normal(size=(100, 2))
    source = GoalSource(proposals, np.full((5, 2), 7.0), np.array([9.0, 9.0]), 0.3)
    goals = plan_goals(source, 400, 200, 2, 0.05, rng)
    assert (goals[:2] == 9.0).all()
    from_rewarded = (goals[2:, 0] == 7.0).all(1)
    assert from_rewarded.mean() == pytest.approx(0.3, abs=0.07)
    assert (goals[2:][from_rewarded] == 7.0).all()
    free = goals[2:][~from_rewarded]
    changes = (free[:, 1:] != free[:, :-1]).any(-1).mean()
    assert changes == pytest.approx(0.05 * 0.99, abs=0.005)


def test_skewed_goals_cover_more(tmp_path, make_corridor, corridor_config) -> None:
    base = replace(
        corridor_config,
        total_steps=6000,
        checkpoint_every=10**6,
        sac=replace(
            corridor_config.sac,
            hidden=(64, 64),
            batch_size=128,
            learning_rate=2e-3,
            target_entropy=-1.0,
            updates_per_step=0.25,
        ),
        skew=replace(
            corridor_config.skew,
            running_scale=False,
            intrinsic=0.02,
            extrinsic=0.0,
            sigma=1.0,
            history_bandwidth=0.3,
            field_weights=(),
        ),
        # Nothing else that explores.
        rollout=replace(
            corridor_config.rollout,
            num_envs=10,
            noise_probability=0.0,
            switch_probability=0.0,
            rewarded_goal_max=0.0,
            evaluation_envs=0,
        ),
        replay=replace(corridor_config.replay, capacity_steps=100_000),
    )
    covered = {}
    for exponent in (-2.5, 0.0):
        shares = []
        for seed in (0, 1):
            config = replace(base, seed=seed, skew=replace(base.skew, weight_exponent=exponent))
            run_dir = tmp_path / f"{exponent}_{seed}"
            result = run_train(config, make_corridor(10), run_dir, progress=False)
            shares.append(result.metrics["covered_cells"])
        covered[exponent] = np.mean(shares)
    assert covered[-2.5] > covered[0.0] + 0.05, covered
