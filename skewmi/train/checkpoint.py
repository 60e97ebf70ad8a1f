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

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from skewmi.errors import (
    CheckpointError,
    ConfigurationError,
    LayoutMismatchError,
    OutputError,
)
from skewmi.outputs import make_folder, sync, writing
from skewmi.policy_io import PolicyLayout
from skewmi.train.blocks import write_blocks
from skewmi.train.config import TrainConfig
from skewmi.train.config_json import from_document, to_document
from skewmi.train.files import write_text
from skewmi.train.replay import Replay
from skewmi.train.state import State, merge, split

FORMAT = 2
KEPT = 2
"""Checkpoints kept; the one before the latest is there in case the disk loses the latest."""
_BEST = "best-"


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint as read."""

    path: Path
    state: State


def write_run_header(run_dir: Path, config: TrainConfig, layout: PolicyLayout) -> None:
    """Save what a run is, before anything can change it.

    Raises:
        ConfigurationError: A number is infinite or not a number, which JSON has no word for.
    """
    content = {
        "format": FORMAT,
        "config": to_document(config),
        "layout": json.loads(layout.to_json()),
        "layout_hash": layout.hash(),
    }
    try:
        text = json.dumps(content, indent=1, allow_nan=False)
    except ValueError as error:
        raise ConfigurationError(f"the configuration has a number without end: {error}") from error
    make_folder(run_dir)
    write_text(run_dir / "config.json", text + "\n")


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
        config = from_document(content["config"])
    except FileNotFoundError as error:
        raise CheckpointError(f"{run_dir} is no run directory: it has no config.json") from error
    except (
        OSError, ValueError, KeyError, TypeError, LayoutMismatchError, ConfigurationError,
    ) as error:  # fmt: skip
        raise CheckpointError(f"{path} is damaged: {error}") from error
    if layout.hash() != content["layout_hash"]:
        raise CheckpointError(f"{path} is damaged: its layout does not have the recorded hash")
    return config, layout


def write_checkpoint(
    run_dir: Path,
    step: int,
    state: State,
    history: Replay | None,
    *,
    best: bool = False,
) -> Path:
    """Write a checkpoint and drop old ones.

    Args:
        run_dir: Of the run.
        step: Environment steps so far; names the checkpoint.
        state: Everything but the episodes: weights, optimizers, counters, random streams.
        history: Episodes to keep; None for a checkpoint that is only to be used, not resumed.
        best: Whether this is the best policy so far instead of the latest state.

    Returns:
        Where it is.

    Raises:
        OutputError: It cannot be written; the run can be resumed from the one before.
    """
    root = run_dir / "checkpoints"
    target = root / (f"{_BEST}{step:010d}" if best else f"{step:010d}")
    temporary = root / f".writing-{target.name}"
    shutil.rmtree(temporary, ignore_errors=True)
    earlier = [path for path in _checkpoints(run_dir, best=False) if path != target]
    try:
        with writing(target):
            _write_parts(temporary, state, history, earlier[-1] if earlier else None)
            if target.exists():
                shutil.rmtree(target)
            os.replace(temporary, target)
            sync(root)
    except SafetensorError as error:
        raise OutputError(f"cannot write {target}: {error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    for old in _checkpoints(run_dir, best=best)[: -1 if best else -KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    return target


def _write_parts(folder: Path, state: State, history: Replay | None, earlier: Path | None) -> None:
    """Write a checkpoint's files into a new folder, and wait until they are on the disk."""
    folder.mkdir(parents=True)
    tensors, rest = split(state)
    save_file(
        {k: v.detach().cpu().clone().contiguous() for k, v in tensors.items()},
        folder / "weights.safetensors",
    )
    (folder / "state.json").write_text(json.dumps(rest))
    if history is not None:
        write_blocks(history, folder / "replay", None if earlier is None else earlier / "replay")
        sync(folder / "replay")
    for name in ("weights.safetensors", "state.json"):
        sync(folder / name)
    sync(folder)


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
        state = merge(tensors, json.loads((path / "state.json").read_text()))
    except (OSError, ValueError, TypeError, AttributeError, SafetensorError) as error:
        raise CheckpointError(f"checkpoint {path} is damaged: {error}") from error
    return Checkpoint(path, state)
