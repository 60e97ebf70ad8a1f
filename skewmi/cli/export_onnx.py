"""Write a run's policy as one self-describing ONNX file, verified against torch.

Runs the policy in the simulation, compares onnxruntime with torch over the observations it met,
and writes the file only if no action differs by more than 1e-5. Then the written file is loaded
as a robot would load it, and runs the same episodes.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from skewmi import extras
from skewmi.batch_env import BatchEnv
from skewmi.cli.policies import Which, load_run, make_env, task_options
from skewmi.errors import CheckpointError, VerificationError
from skewmi.evaluation.rollout import run_episodes, summarise
from skewmi.outputs import check_output
from skewmi.progress import progress

if TYPE_CHECKING:
    from skewmi.train.policy import TorchPolicy


@dataclass(frozen=True)
class ExportOnnxCommand:
    """Options of `skewmi export-onnx`."""

    run_dir: Annotated[Path, tyro.conf.Positional]
    """Run directory of skewmi train."""
    out: Path
    """File to write."""
    overwrite: bool = False
    """Replace an existing file; never one of the run's own."""
    which: Which = "latest"
    """Which checkpoint."""
    episodes: int = 100
    """Episodes to record observations in, and to compare the success rates over."""
    seed: int = 0
    """Seed of these episodes."""
    num_envs: int = 0
    """Environments stepped together; 0: as many as episodes, at most 50."""
    num_threads: int = 0
    """Threads that step them; 0: automatic."""
    option: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Option of the task, NAME=VALUE with VALUE in JSON, as start_noise=0.3; may be repeated."""
    json: bool = False
    """Print one JSON document instead of text."""


def run_export_onnx(options: ExportOnnxCommand) -> int:
    """Export. Returns 0 if the file was written, 1 if it differed from torch and was not."""
    policy = load_run(options.run_dir, options.which)
    own = [path for path in options.run_dir.rglob("*") if path.suffix != ".onnx"]
    check_output(options.out, overwrite=options.overwrite, inputs=own)
    from_run = run_metadata(options.run_dir, policy)
    try:
        from skewmi.export.onnx_export import export_policy
    except ModuleNotFoundError as error:
        raise extras.missing("exporting", error) from error
    from skewmi.deploy.policy import OnnxPolicy

    layout = policy.layout
    env = make_env(
        layout.task,
        options.num_envs,
        options.episodes,
        options.num_threads,
        options.seed,
        task_options(layout.task, layout, options.option),
    )
    with progress("recording observations with torch", "steps") as bar:
        recorded = run_episodes(policy, env, options.episodes, options.seed, progress=bar)
    by_torch = summarise(recorded)
    metadata = {
        **from_run,
        **robot_metadata(env),
        "evaluation": {**by_torch, "seed": options.seed, "num_envs": env.num_envs},
    }
    try:
        report = export_policy(policy, options.out, recorded.observation, metadata=metadata)
    except VerificationError as error:
        print(f"skewmi export-onnx: {error}", file=sys.stderr)
        return 1
    with progress("running the file", "steps") as bar:
        written = OnnxPolicy.load(options.out)
        repeated = run_episodes(written, env, options.episodes, options.seed, progress=bar)
    by_onnx = summarise(repeated)
    figures: dict[str, Any] = {
        "path": str(report.path),
        "size_bytes": report.size_bytes,
        "sha256": report.sha256,
        "layout_hash": report.layout_hash,
        "observations": report.observations,
        "max_difference": report.max_difference,
        "episodes": by_torch["episodes"],
        "success_rate_torch": by_torch["success_rate"],
        "success_rate_onnx": by_onnx["success_rate"],
        "torch": by_torch,
        "onnx": by_onnx,
    }
    print(json.dumps(figures, indent=2) if options.json else as_text(figures))
    return 0


def run_metadata(run_dir: Path, policy: TorchPolicy) -> dict[str, Any]:
    """Where a policy came from: reference point, sha256 of its weights, whole configuration.

    Raises:
        CheckpointError: The run went on and dropped this checkpoint, or cannot be read.
    """
    weights = run_dir / "checkpoints" / policy.metadata["checkpoint"] / "weights.safetensors"
    try:
        digest = hashlib.sha256(weights.read_bytes()).hexdigest()
        config = json.loads((run_dir / "config.json").read_text())["config"]
    except (OSError, ValueError, KeyError) as error:
        raise CheckpointError(f"cannot read {weights} or its run: {error}") from error
    names = [field.name for field in policy.layout.state_fields]
    return {
        "reference_point": dict(zip(names, policy.goal.tolist(), strict=True)),
        "checkpoint_sha256": digest,
        "training_config": _finite(config),
    }


def robot_metadata(env: BatchEnv) -> dict[str, Any]:
    """Which robot a task's arm is and what bounded its motion in training; None without an arm."""
    layout = env.layout
    if layout.workspace is None:
        return {"robot": None, "robot_model_hash": None, "limits": None}
    from skewmi.robot_models import yumi
    from skewmi.robot_models.kinematics import ArmKinematics
    from skewmi.sim import tasks

    # What its servos may do is the scene's business.
    task = tasks.find(layout.task).arm
    assert task is not None

    arm = ArmKinematics()
    speed = layout.action_scale / layout.control_dt
    return {
        "robot": "yumi",
        "robot_model_hash": yumi.MODEL_HASH,
        "limits": {
            "joint_position_lower": arm.position_lower.tolist(),
            "joint_position_upper": arm.position_upper.tolist(),
            "joint_force": np.asarray(task.servo.force_limit).tolist(),
            "command_speed": {
                field.name: value
                for field, value in zip(layout.action, speed.tolist(), strict=True)
            },
            "free_lead": layout.workspace.free_following_error,
            "held_lead": layout.workspace.held_following_error,
        },
    }


def _finite(value: Any) -> Any:
    """JSON has no infinity, and configurations use it for "no bound": None in the file."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def as_text(figures: dict[str, Any]) -> str:
    """The figures of `run_export_onnx` for people."""
    return (
        f"{figures['path']}: {figures['size_bytes'] / 1024:.0f} KiB, "
        f"sha256 {figures['sha256'][:16]}..., layout {figures['layout_hash'][:16]}...\n"
        f"  onnxruntime and torch differ by at most {figures['max_difference']:.2g} over "
        f"{figures['observations']} observations\n"
        f"  success rate over {figures['episodes']} episodes: torch "
        f"{figures['success_rate_torch']:.1%}, ONNX {figures['success_rate_onnx']:.1%}"
    )
