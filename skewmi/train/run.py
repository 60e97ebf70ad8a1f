"""A whole run in a directory: start or resume, iterate, log, checkpoint, stop."""

from __future__ import annotations

import time
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import torch

from skewmi.batch_env import BatchEnv
from skewmi.errors import CheckpointError, ConfigurationError
from skewmi.policy_io import Policy, require_same_layout
from skewmi.train.checkpoint import (
    Checkpoint,
    read_checkpoint,
    read_run_header,
    write_checkpoint,
    write_run_header,
)
from skewmi.train.checks import require
from skewmi.train.columns import COLUMNS, TIME_COLUMNS, headline
from skewmi.train.config import TrainConfig
from skewmi.train.lock import only_training
from skewmi.train.log import MetricsTable, ProgressBar
from skewmi.train.memory import keep_freed_memory
from skewmi.train.runner import Runner

# How a run is paced may change between its parts; what it computes may not.
_PACE = ("total_steps", "minutes", "stop_on_convergence", "checkpoint_every")


@dataclass(frozen=True)
class TrainResult:
    """What a run came to."""

    run_dir: str
    steps: int
    trajectories: int
    rewarded: bool
    """Whether the task's reward was paid."""
    taught_by: str
    """The policy file that began it, or empty."""
    refreshes: int
    """Of the exploration."""
    converged_at: int | None
    """Trajectories after which our criterion of convergence held first, or None."""
    converged_at_paper: int | None
    """Trajectories after which the published one held first, or None."""
    evaluation_fraction: float
    """Rewarded fraction of the last 10 states of the last 10 trajectories that count."""
    discoveries: dict[str, dict[str, int]]
    """First trajectory and step of each event."""
    stopped_by: str
    """`steps`, `minutes` or `convergence`."""
    seconds: float
    """Of this part of the run, wall clock."""
    metrics: dict[str, float]
    """Last row of the table."""


def run_train(
    config: TrainConfig,
    env: BatchEnv,
    run_dir: Path,
    *,
    resume: bool = False,
    start_from: Path | None = None,
    teacher: Policy | None = None,
    progress: bool = True,
) -> TrainResult:
    """Train in `run_dir` until a budget is spent or, if asked for, until convergence.

    A run that was interrupted at any moment continues with `resume` exactly as if it had not been:
    same table but for the times, same weights to the bit (on the same machine and threads).

    Args:
        config: Everything about the run; when resuming, as the run was started but for its pace.
        env: As many environments as the configuration says.
        run_dir: Created; must not hold a run unless resuming.
        resume: Continue from the latest checkpoint; with none yet, start.
        start_from: Directory of another run, of the same networks and layout: a new run begins
            with its networks, episodes and counters, but its own random streams, say under another
            variation of the model.
        teacher: Of a run that is taught (`TrainConfig.taught_by`), until it has converged.
        progress: Bar on standard error.

    Raises:
        ConfigurationError: The environment does not fit, or the directory holds a run already.
        CheckpointError: The checkpoint is damaged or of another run.
        LayoutMismatchError: The checkpoint is of another observation or action layout.
    """
    run_dir = Path(run_dir)
    _require_usable(config, env)
    started = time.monotonic()
    torch.set_num_threads(config.threads)
    keep_freed_memory()
    with only_training(run_dir):
        runner, resumed_at = _open(config, env, run_dir, resume, start_from, teacher)
        return _train(runner, run_dir, resumed_at, progress=progress, started=started)


def _train(
    runner: Runner, run_dir: Path, resumed_at: int | None, *, progress: bool, started: float
) -> TrainResult:
    """`run_train` in a directory that is ours alone, from where the runner is."""
    config = runner.config
    before = earlier_seconds(run_dir) if resumed_at is not None else 0.0
    own = (*runner.learner.metrics, *runner.exploration.metrics)
    table = MetricsTable(run_dir, (*COLUMNS, *own, *TIME_COLUMNS), resumed_at)
    try:
        shown = (config.total_steps, progress, config.minutes, config.stop_on_convergence)
        with ProgressBar(*shown) as bar:
            metrics, stopped_by = _iterate(
                config, runner, run_dir, table, bar, started=started, before=before
            )
    finally:
        table.close()
    return TrainResult(
        run_dir=str(run_dir),
        steps=runner.steps,
        trajectories=runner.episodes,
        rewarded=config.rewarded,
        taught_by=config.taught_by,
        refreshes=runner.exploration.refreshes,
        converged_at=runner.convergence.at,
        converged_at_paper=runner.convergence.published_at,
        evaluation_fraction=runner.convergence.fraction,
        discoveries=runner.discoveries.first,
        stopped_by=stopped_by,
        seconds=time.monotonic() - started,
        metrics=metrics,
    )


def _require_usable(config: TrainConfig, env: BatchEnv) -> None:
    wanted = config.rollout.num_envs
    require(
        env.num_envs == wanted,
        f"the environment has {env.num_envs} copies, the configuration {wanted}",
    )
    require(
        config.device != "cuda" or torch.cuda.is_available(),
        "device is cuda, but this machine has none; use --device cpu",
    )


def _iterate(
    config: TrainConfig,
    runner: Runner,
    run_dir: Path,
    table: MetricsTable,
    bar: ProgressBar,
    *,
    started: float,
    before: float,
) -> tuple[dict[str, float], str]:
    """Iterate until a reason to stop; the last metrics, and the reason.

    Args:
        config: When to stop and to write a checkpoint.
        runner: At an iteration's beginning.
        run_dir: Of the run.
        table: Gets a row per iteration.
        bar: Shows progress.
        started: When this part of the run started, on the monotonic clock.
        before: Wall-clock seconds of earlier parts of the run.
    """
    metrics: dict[str, float] = {}
    while (stop := _stop_reason(config, runner, time.monotonic() - started)) is None:
        # The best one is what was evaluated, so it is written before that learns on. If the run
        # dies before the next checkpoint, going on from the one before writes the same again.
        metrics, new = runner.iterate(partial(_save, runner, run_dir, best=True))
        metrics["seconds"] = before + time.monotonic() - started
        # The row first: rows after the checkpoint are dropped on resuming, so a kill between the
        # two costs neither a row nor doubles one.
        table.write(metrics)
        if runner.iteration % config.checkpoint_every == 0:
            _save(runner, run_dir)
        for name in new:
            bar.note(f"first {name}: trajectory {runner.discoveries.first[name]['trajectory']:,}")
        bar.update(runner.steps, runner.iteration, headline(metrics))
    if metrics and runner.iteration % config.checkpoint_every != 0:
        _save(runner, run_dir)
    return metrics, stop


def _save(runner: Runner, run_dir: Path, *, best: bool = False) -> None:
    history = None if best else runner.history
    write_checkpoint(run_dir, runner.steps, runner.state_dict(), history, best=best)


def earlier_seconds(run_dir: Path) -> float:
    """Wall-clock seconds that earlier parts of a run took."""
    try:
        last = (run_dir / "metrics.csv").read_text().strip().splitlines()[-1]
        return float(last.split(",")[-1])
    except (OSError, ValueError, IndexError):
        return 0.0


def _open(
    config: TrainConfig,
    env: BatchEnv,
    run_dir: Path,
    resume: bool,
    start_from: Path | None,
    teacher: Policy | None,
) -> tuple[Runner, int | None]:
    """The runner, and the step of the checkpoint it continues from."""
    if teacher is not None:
        require_same_layout(env.layout, teacher.layout, "the teacher")
    exists = (run_dir / "config.json").exists()
    if exists and not resume:
        raise ConfigurationError(
            f"{run_dir} holds a run already; continue it with --resume or choose another directory"
        )
    if exists:
        earlier, layout = read_run_header(run_dir)
        require_same_layout(env.layout, layout, f"the run in {run_dir}")
        _require_same_config(config, earlier, run_dir)
    has_checkpoint = exists and any((run_dir / "checkpoints").glob("[0-9]*"))
    origin = None if has_checkpoint else _origin(config, env, run_dir, start_from)
    # Both before anything is written: they refuse what does not fit.
    runner = Runner(config, env, teacher)
    if not has_checkpoint:
        _require_teacher(runner, run_dir)
    if origin is not None:
        runner.begin_with(origin)
    write_run_header(run_dir, config, env.layout)
    if not has_checkpoint:
        return runner, (0 if exists else None)
    checkpoint = read_checkpoint(run_dir)
    if checkpoint.state.get("layout_hash") != env.layout.hash():
        raise CheckpointError(f"checkpoint {checkpoint.path} was made for another layout")
    runner.load(checkpoint)
    _require_teacher(runner, run_dir)
    return runner, runner.steps


def _require_teacher(runner: Runner, run_dir: Path) -> None:
    """A run that is still being taught needs its teacher."""
    taught_by = runner.config.taught_by
    require(
        runner.beginnings.teacher is not None or not runner.needs_teacher,
        f"the run in {run_dir} is taught by {taught_by} and has not converged at step "
        f"{runner.steps}: give the same --teacher again",
    )


def _origin(
    config: TrainConfig, env: BatchEnv, run_dir: Path, start_from: Path | None
) -> Checkpoint | None:
    """The checkpoint of another run that one without any of its own begins with."""
    if start_from is None:
        require(
            not config.started_from,
            f"the run in {run_dir} began with {config.started_from}, and ended before its first "
            "checkpoint: give the same --start-from again, or begin in another directory",
        )
        return None
    _, layout = read_run_header(start_from)
    require_same_layout(env.layout, layout, f"the run in {start_from}")
    origin = read_checkpoint(start_from)
    now = started_from(start_from, origin)
    require(
        config.started_from in ("", now),
        f"the run in {run_dir} began with {config.started_from}, and {start_from} is now at {now}: "
        "begin in another directory",
    )
    return origin


def started_from(run_dir: Path, checkpoint: Checkpoint) -> str:
    """What a configuration says of the run that it began with."""
    return f"{run_dir.resolve().name}, step {checkpoint.state['step']}"


def _require_same_config(config: TrainConfig, earlier: TrainConfig, run_dir: Path) -> None:
    same_pace = replace(earlier, **{name: getattr(config, name) for name in _PACE})
    if config == same_pace:
        return
    parts = [
        f.name for f in fields(config) if getattr(config, f.name) != getattr(same_pace, f.name)
    ]
    raise ConfigurationError(
        f"the run in {run_dir} was started with another {', '.join(parts)}; resume it with the "
        f"same configuration (only {', '.join(_PACE)} may change)"
    )


def _stop_reason(config: TrainConfig, runner: Runner, seconds: float) -> str | None:
    if config.stop_on_convergence and runner.convergence.converged:
        return "convergence"
    if runner.steps >= config.total_steps:
        return "steps"
    if config.minutes is not None and seconds >= 60.0 * config.minutes:
        return "minutes"
    return None
