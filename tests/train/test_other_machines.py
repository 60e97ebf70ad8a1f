"""What a run needs where it was not trained: its policy nearly nothing, its resumption all."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from skewmi.errors import CheckpointError
from skewmi.train.checkpoint import read_checkpoint, read_run_header
from skewmi.train.config import TrainConfig
from skewmi.train.policy import load_policy
from skewmi.train.ppo.config import PpoConfig
from skewmi.train.run import run_train
from skewmi.train.sac import engines

SEEN = np.random.default_rng(0).uniform(0.0, 4.0, (6, 3))
ITERATION = 5 * 40


def trained_elsewhere(run_dir: Path, engine: str, named: str) -> None:
    """Make a run's files what a GPU or a compiler would have left.

    Args:
        run_dir: Of the run.
        engine: That its checkpoint names.
        named: That its configuration asks for.
    """
    folder = read_checkpoint(run_dir).path
    state = json.loads((folder / "state.json").read_text())
    if "engine" in state["learner"]:
        state["learner"]["engine"] = engine
        header = json.loads((run_dir / "config.json").read_text())
        header["config"]["learner"]["engine"] = named
        (run_dir / "config.json").write_text(json.dumps(header))
    (folder / "state.json").write_text(json.dumps(state))
    tensors = load_file(folder / "weights.safetensors")
    # Seed and offset: all that a CUDA generator's state holds.
    tensors["learner/generator"] = torch.zeros(16, dtype=torch.uint8)
    save_file(tensors, folder / "weights.safetensors")


@pytest.fixture
def config(corridor_config: TrainConfig) -> TrainConfig:
    learner = replace(corridor_config.learner, engine="auto", actor_average=0.9)
    rollout = replace(corridor_config.rollout, random_steps=0, noise_probability=0.0)
    return replace(corridor_config, learner=learner, rollout=rollout, total_steps=2 * ITERATION)


@pytest.fixture(autouse=True)
def without_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "can_compile", lambda device: False)


@pytest.mark.parametrize("engine", ["compiled", "captured"])
@pytest.mark.parametrize("by_name", [False, True])
def test_a_policy_needs_neither_compiler_nor_gpu(
    tmp_path, make_corridor, config, engine: str, by_name: bool
) -> None:
    run_train(config, make_corridor(), tmp_path, progress=False)
    expected = load_policy(tmp_path).act(SEEN)
    trained_elsewhere(tmp_path, engine, engine if by_name else "auto")
    np.testing.assert_array_equal(load_policy(tmp_path).act(SEEN), expected)


def test_a_policy_with_a_memory_needs_no_gpu(tmp_path, make_corridor, config) -> None:
    learner = PpoConfig(memory=8, heads=(8,), steps_per_update=ITERATION, epochs=1, minibatches=2)
    run_train(replace(config, learner=learner), make_corridor(), tmp_path, progress=False)
    expected = load_policy(tmp_path).act(SEEN)
    trained_elsewhere(tmp_path, "captured", "auto")
    np.testing.assert_array_equal(load_policy(tmp_path).act(SEEN), expected)


def test_loading_a_policy_draws_nothing_from_the_global_stream(
    tmp_path, make_corridor, config
) -> None:
    run_train(config, make_corridor(), tmp_path, progress=False)
    before = torch.random.get_rng_state()
    load_policy(tmp_path)
    assert torch.equal(torch.random.get_rng_state(), before)


def test_weights_of_another_network_are_refused(tmp_path, make_corridor, config) -> None:
    run_train(config, make_corridor(), tmp_path, progress=False)
    header = json.loads((tmp_path / "config.json").read_text())
    header["config"]["learner"]["hidden"] = [16, 16]
    (tmp_path / "config.json").write_text(json.dumps(header))
    with pytest.raises(CheckpointError, match="do not fit"):
        load_policy(tmp_path)


def test_a_resumed_run_keeps_its_engine_and_a_new_one_may_take_another(
    tmp_path, make_corridor, config
) -> None:
    origin, begun = tmp_path / "origin", tmp_path / "begun"
    run_train(config, make_corridor(), origin, progress=False)
    trained_elsewhere(origin, "captured", "auto")
    longer = replace(config, total_steps=4 * ITERATION)
    with pytest.raises(CheckpointError, match=r"--start-from RUN --learner\.engine eager"):
        run_train(longer, make_corridor(), origin, resume=True, progress=False)
    with pytest.raises(CheckpointError, match=r"--start-from RUN --learner\.engine eager"):
        run_train(longer, make_corridor(), begun, start_from=origin, progress=False)
    assert not begun.exists()
    eager = replace(longer, learner=replace(longer.learner, engine="eager"))
    result = run_train(eager, make_corridor(), begun, start_from=origin, progress=False)
    assert result.steps == 4 * ITERATION
    assert read_checkpoint(begun).state["learner"]["engine"] == "eager"
    assert read_run_header(begun)[0].learner == eager.learner
    run_train(
        replace(eager, total_steps=5 * ITERATION), make_corridor(), begun, resume=True,
        progress=False,
    )  # fmt: skip
