"""Checkpoints: written aside and renamed, so that each is whole or absent; no pickle anywhere.

run_dir/config.json                      resolved configuration, layout, its hash
run_dir/checkpoints/<step>/              weights.safetensors  state.json  replay/*.npy
run_dir/checkpoints/best-<step>/         weights.safetensors  state.json
"""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from skewmi.errors import CheckpointError, LayoutMismatchError
from skewmi.policy_io import PolicyLayout
from skewmi.train.blocks import write_blocks
from skewmi.train.config import TrainConfig
from skewmi.train.files import sync, write_text
from skewmi.train.inputs import InputNormalizer
from skewmi.train.policy import TorchPolicy
from skewmi.train.replay import Replay
from skewmi.train.sac.networks import Actor

FORMAT = 1
KEPT = 2
"""Checkpoints kept; the one before the latest is there in case the disk loses the latest."""
_BEST = "best-"


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint as read."""

    path: Path
    tensors: dict[str, Tensor]
    state: dict[str, Any]


def write_run_header(run_dir: Path, config: TrainConfig, layout: PolicyLayout) -> None:
    """Save what a run is, before anything can change it."""
    run_dir.mkdir(parents=True, exist_ok=True)
    content = {
        "format": FORMAT,
        "config": json.loads(config.to_json()),
        "layout": json.loads(layout.to_json()),
        "layout_hash": layout.hash(),
    }
    write_text(run_dir / "config.json", json.dumps(content, indent=1) + "\n")


def read_run_header(run_dir: Path) -> tuple[TrainConfig, PolicyLayout]:
    """Configuration and layout of a run.

    Raises:
        CheckpointError: There is no run, or it is damaged.
    """
    path = run_dir / "config.json"
    try:
        content = json.loads(path.read_text())
        if content["format"] != FORMAT:
            raise CheckpointError(
                f"{path} has format {content['format']}, this skewmi reads {FORMAT}"
            )
        layout = PolicyLayout.from_json(json.dumps(content["layout"]))
        config = TrainConfig.from_json(json.dumps(content["config"]))
    except FileNotFoundError as error:
        raise CheckpointError(f"{run_dir} is no run directory: it has no config.json") from error
    except (OSError, ValueError, KeyError, TypeError, LayoutMismatchError) as error:
        raise CheckpointError(f"{path} is damaged: {error}") from error
    if layout.hash() != content["layout_hash"]:
        raise CheckpointError(f"{path} is damaged: its layout does not have the recorded hash")
    return config, layout


def write_checkpoint(
    run_dir: Path,
    step: int,
    tensors: dict[str, Tensor],
    state: dict[str, Any],
    replay: Replay | None,
    *,
    best: bool = False,
) -> Path:
    """Write a checkpoint and drop old ones.

    Args:
        run_dir: Of the run.
        step: Environment steps so far; names the checkpoint.
        tensors: Weights, optimizer and random states.
        state: JSON-serialisable rest.
        replay: Episodes to keep; None for a checkpoint that is only to be used, not resumed.
        best: Whether this is the best policy so far instead of the latest state.

    Returns:
        Where it is.
    """
    root = run_dir / "checkpoints"
    root.mkdir(parents=True, exist_ok=True)
    target = root / (f"{_BEST}{step:010d}" if best else f"{step:010d}")
    temporary = root / f".writing-{target.name}"
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir()
    save_file(
        {k: v.detach().cpu().clone().contiguous() for k, v in tensors.items()},
        temporary / "weights.safetensors",
    )
    (temporary / "state.json").write_text(json.dumps(state))
    if replay is not None:
        earlier = [path for path in _checkpoints(run_dir, best=False) if path != target]
        write_blocks(replay, temporary / "replay", earlier[-1] / "replay" if earlier else None)
        sync(temporary / "replay")
    for name in ("weights.safetensors", "state.json"):
        sync(temporary / name)
    sync(temporary)
    if target.exists():
        shutil.rmtree(target)
    os.replace(temporary, target)
    sync(root)
    for old in _checkpoints(run_dir, best=best)[: -1 if best else -KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    return target


def _checkpoints(run_dir: Path, *, best: bool) -> list[Path]:
    """Finished checkpoints of one kind, oldest first."""
    root = run_dir / "checkpoints"
    if not root.is_dir():
        return []
    paths = [p for p in root.iterdir() if p.is_dir() and not p.name.startswith(".")]
    chosen = [p for p in paths if p.name.startswith(_BEST) == best]
    return sorted(p for p in chosen if p.name.removeprefix(_BEST).isdigit())


def read_checkpoint(run_dir: Path, which: str = "latest") -> Checkpoint:
    """Read the latest or the best checkpoint.

    Raises:
        CheckpointError: There is none, or it is damaged.
    """
    if which not in ("latest", "best"):
        raise CheckpointError(f"checkpoint {which!r} is asked for; allowed: latest, best")
    paths = _checkpoints(run_dir, best=which == "best")
    if not paths and which == "best":
        paths = _checkpoints(run_dir, best=False)  # nothing was rewarded yet
    if not paths:
        raise CheckpointError(f"{run_dir} has no checkpoint yet")
    path = paths[-1]
    try:
        tensors = load_file(path / "weights.safetensors")
        state: dict[str, Any] = json.loads((path / "state.json").read_text())
    except (OSError, ValueError, SafetensorError) as error:
        raise CheckpointError(f"checkpoint {path} is damaged: {error}") from error
    return Checkpoint(path, tensors, state)


def load_policy(run_dir: Path, which: str = "latest") -> TorchPolicy:
    """The policy of a run, ready to act.

    Its goal is the one that the run's evaluation episodes had: once
    a reward was met, the most central of the recently rewarded states; before that, the last
    proposal.

    Args:
        run_dir: Of the run.
        which: `latest`, or `best` by the rewarded fraction of the evaluation episodes.

    Raises:
        CheckpointError: There is no such run or checkpoint, or it is damaged.
    """
    run_dir = Path(run_dir)
    config, layout = read_run_header(run_dir)
    checkpoint = read_checkpoint(run_dir, which)
    inputs = InputNormalizer(layout, config.sac.normalize_input)
    bounds = (config.sac.log_std_min, config.sac.log_std_max)
    actor = Actor(inputs.dim, layout.action_dim, config.sac.hidden, bounds)
    prefix = "actor."
    try:
        actor.load_state_dict(
            {
                k[len(prefix) :]: torch.as_tensor(v)
                for k, v in checkpoint.tensors.items()
                if k.startswith(prefix)
            }
        )
        goal = np.asarray(checkpoint.state["evaluation_goal"], dtype=np.float64)
        metadata = {
            "task": layout.task,
            "method": "skew-explore",
            "preset": config.preset,
            "seed": config.seed,
            "task_options": dict(config.task_options),
            "environment_steps": checkpoint.state["step"],
            "updates": checkpoint.state["updates"],
            "evaluation_fraction": checkpoint.state["evaluation_fraction"],
            "checkpoint": checkpoint.path.name,
            "layout_hash": layout.hash(),
        }
    except (KeyError, RuntimeError, ValueError) as error:
        raise CheckpointError(f"checkpoint {checkpoint.path} is damaged: {error}") from error
    return TorchPolicy(layout, actor, inputs, goal, metadata)
