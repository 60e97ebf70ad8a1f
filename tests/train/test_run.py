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
from train_runs import assert_same_checkpoint, assert_same_table, resumes_alike

from skewmi.errors import CheckpointError, ConfigurationError, LayoutMismatchError
from skewmi.train import checkpoint as checkpoints
from skewmi.train.checkpoint import read_checkpoint, read_run_header
from skewmi.train.config_json import to_document
from skewmi.train.log import read_metrics
from skewmi.train.policy import load_policy
from skewmi.train.run import run_train

KEPT = 20
"""Episodes in the history of `corridor_config`."""


def test_resumed_run_is_the_uninterrupted_one(tmp_path, make_corridor, corridor_config) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    run_train(corridor_config, make_corridor(), whole, progress=False)
    half = replace(corridor_config, total_steps=corridor_config.total_steps // 2)
    run_train(half, make_corridor(), parts, progress=False)
    result = run_train(corridor_config, make_corridor(), parts, resume=True, progress=False)
    assert result.stopped_by == "steps"
    assert result.steps == corridor_config.total_steps
    assert_same_table(whole, parts)
    assert_same_checkpoint(whole, parts, KEPT)


def test_rows_after_the_checkpoint_are_dropped(tmp_path, make_corridor, corridor_config) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    run_train(corridor_config, make_corridor(), whole, progress=False)
    half = replace(corridor_config, total_steps=600)
    run_train(half, make_corridor(), killed, progress=False)
    # As after a kill between writing the row and the checkpoint, and in the middle of a row.
    with (killed / "metrics.csv").open("a") as file:
        file.write("800,20,99,0" + ",0" * 21 + "\n1000,2")
    run_train(corridor_config, make_corridor(), killed, resume=True, progress=False)
    assert_same_table(whole, killed)


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
        checkpoints.write_checkpoint(killed, 800, {"x": torch.zeros(1), "step": 800}, None)
    monkeypatch.undo()
    assert read_checkpoint(killed).path == before
    # What an interrupt leaves is removed; what a kill leaves is in nobody's way.
    assert not any(p.name.startswith(".writing") for p in before.parent.iterdir())
    (before.parent / ".writing-0000000800").mkdir()
    (before.parent / ".writing-0000000800" / "state.json").write_text("{")
    run_train(config, env, killed, resume=True, progress=False)
    run_train(corridor_config, make_corridor(), killed, resume=True, progress=False)
    assert_same_table(whole, killed)
    assert_same_checkpoint(whole, killed, KEPT)


_CHILD = """
import importlib.util, json, sys
spec = importlib.util.spec_from_file_location("corridor_conftest", sys.argv[1])
m = importlib.util.module_from_spec(spec); spec.loader.exec_module(m)
from pathlib import Path
from skewmi.train.config_json import from_document
from skewmi.train.run import run_train
config = from_document(json.loads(Path(sys.argv[2]).read_text()))
run_train(config, m.Corridor(), Path(sys.argv[3]), resume=True, progress=False)
"""


def test_kill_minus_nine(tmp_path, make_corridor, corridor_config) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    config = replace(corridor_config, total_steps=4000)
    run_train(config, make_corridor(), whole, progress=False)
    (tmp_path / "config.json").write_text(
        json.dumps(to_document(replace(config, total_steps=10**9)))
    )
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
    assert_same_table(whole, killed)
    assert_same_checkpoint(whole, killed, KEPT)


def test_no_pickle_in_a_run(tmp_path, make_corridor, corridor_config) -> None:
    run_train(replace(corridor_config, total_steps=400), make_corridor(), tmp_path, progress=False)
    files = [p for p in tmp_path.rglob("*") if p.is_file()]
    kinds = {p.suffix for p in files if p.parent.name != "tb" and p.name != ".lock"}
    assert kinds == {".json", ".csv", ".safetensors", ".npy"}
    for path in files:
        if path.suffix == ".npy":
            np.load(path, allow_pickle=False, mmap_mode="r")


def test_another_layout_is_refused(tmp_path, make_corridor, corridor_config) -> None:
    half = replace(corridor_config, total_steps=400)
    run_train(half, make_corridor(), tmp_path, progress=False)
    with pytest.raises(LayoutMismatchError, match="another layout"):
        run_train(half, make_corridor(field_high=5.0), tmp_path, resume=True, progress=False)


def test_another_configuration_is_refused(tmp_path, make_corridor, corridor_config) -> None:
    half = replace(corridor_config, total_steps=400)
    run_train(half, make_corridor(), tmp_path, progress=False)
    other = replace(half, exploration=replace(half.exploration, sigma=9.0))
    with pytest.raises(ConfigurationError, match="another exploration"):
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


def test_skewed_goals_cover_more(tmp_path, make_corridor, corridor_config) -> None:
    base = replace(
        corridor_config,
        total_steps=6000,
        checkpoint_every=10**6,
        learner=replace(
            corridor_config.learner,
            hidden=(64, 64),
            batch_size=128,
            learning_rate=2e-3,
            target_entropy=-1.0,
            updates_per_step=0.25,
        ),
        exploration=replace(
            corridor_config.exploration,
            running_scale=False,
            intrinsic=0.02,
            extrinsic=0.0,
            sigma=1.0,
            history_bandwidth=0.3,
            field_weights=(),
            switch_probability=0.0,
            rewarded_goal_max=0.0,
        ),
        # Nothing else that explores.
        rollout=replace(
            corridor_config.rollout,
            num_envs=10,
            noise_probability=0.0,
            evaluation_envs=0,
            history_steps=100_000,
        ),
    )
    covered = {}
    for exponent in (-2.5, 0.0):
        fractions = []
        for seed in (0, 1):
            exploration = replace(base.exploration, weight_exponent=exponent)
            config = replace(base, seed=seed, exploration=exploration)
            run_dir = tmp_path / f"{exponent}_{seed}"
            result = run_train(config, make_corridor(10), run_dir, progress=False)
            fractions.append(result.metrics["covered_cells"])
        covered[exponent] = np.mean(fractions)
    assert covered[-2.5] > covered[0.0] + 0.05, covered


def test_the_budget_does_not_change_what_a_run_computes(
    tmp_path, make_corridor, corridor_config
) -> None:
    """Not even one that ends before there is anything to learn from."""
    rollout = replace(corridor_config.rollout, random_steps=600)
    config = replace(corridor_config, rollout=rollout, total_steps=1000)
    whole = resumes_alike(config, make_corridor, tmp_path, 400)
    updates = read_metrics(whole)["updates"]
    assert [count > 0 for count in updates] == [False, False, True, True, True]
    short = replace(config, total_steps=200)
    run_train(short, make_corridor(), tmp_path / "short", progress=False)
    policy = load_policy(tmp_path / "short")
    assert policy.metadata["updates"] == 0
    assert np.isfinite(policy.act(np.zeros((1, 3)))).all()
