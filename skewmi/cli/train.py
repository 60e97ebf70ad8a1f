"""Learn a task from its sparse reward, in a run directory.

Writes config.json, metrics.csv, tb/ (TensorBoard) and checkpoints/ into the run directory. An
interrupted run continues with --resume exactly as if it had not been. Every number of the preset
has a flag of its own, say --learner.batch-size 128 or --exploration.sigma 1; the defaults shown
below are those of the --task, --preset, --learner and --exploration given with --help.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from rich.console import Console

from skewmi import matrix_kernels
from skewmi.cli.train_config import load_teacher, resolve
from skewmi.cli.train_options import TrainCommand, default_options
from skewmi.outputs import check_output
from skewmi.policy_io import Policy
from skewmi.sim import tasks
from skewmi.train import run
from skewmi.train.config import TrainConfig
from skewmi.train.run import TrainResult

__all__ = ["TrainCommand", "as_text", "default_options", "run_train", "train"]


def train(
    config: TrainConfig,
    run_dir: Path,
    *,
    resume: bool = False,
    start_from: Path | None = None,
    teacher: Policy | None = None,
    progress: bool = True,
) -> TrainResult:
    """Make the environment of a configuration and train, see `skewmi.train.run.run_train`."""
    env = tasks.make_batch(
        config.task,
        config.rollout.num_envs,
        num_threads=config.threads,
        seed=config.seed,
        **dict(config.task_options),
    )
    return run.run_train(
        config,
        env,
        run_dir,
        resume=resume,
        start_from=start_from,
        teacher=teacher,
        progress=progress,
    )


def as_text(result: TrainResult) -> str:
    """A few lines for people."""
    lines = [
        f"{result.steps:,} steps, {result.trajectories:,} trajectories in "
        f"{result.seconds / 60:.1f} min (stopped by {result.stopped_by}); run: {result.run_dir}"
    ]
    if result.taught_by:
        lines.append(f"  begun by {result.taught_by[:32]}..., whose episodes are counted below")
    lines += [
        f"  first {name}: trajectory {first['trajectory']:,}"
        for name, first in result.discoveries.items()
    ]
    return "\n".join([*lines, *(f"  {line}" for line in _learned(result))])


def _learned(result: TrainResult) -> list[str]:
    """How far it got: converged or not, or what was explored if nothing was to be learned."""
    if not result.rewarded:
        shown = ("entropy", "coverage", "differential_entropy", "covered_cells")
        figures = [f"{name} {result.metrics[name]:.3g}" for name in shown if name in result.metrics]
        return [f"explored without a target, {result.refreshes:,} refreshes", ", ".join(figures)]
    share = f"{result.evaluation_fraction:.0%} of the last states rewarded"
    lines = [f"not converged ({share})"]
    if result.converged_at is not None:
        lines = [f"converged after {result.converged_at:,} trajectories"]
    if result.converged_at_paper is not None:
        lines += [f"published criterion met after {result.converged_at_paper:,} trajectories"]
    return lines


def run_train(options: TrainCommand) -> int:
    """Train and print the result. Returns 0."""
    config, teacher = resolve(options), load_teacher(options)
    if matrix_kernels.taken() and not options.quiet:
        print(matrix_kernels.TAKEN, file=sys.stderr)
    with _shown(options):
        result = train(
            config,
            options.run_dir,
            resume=options.resume,
            start_from=options.start_from,
            teacher=teacher,
            progress=not options.quiet,
        )
    print(json.dumps(asdict(result), indent=2) if options.json else as_text(result))
    return 0


@contextmanager
def _shown(options: TrainCommand) -> Iterator[None]:
    """Show the training meanwhile, if asked to; what becomes of the view does not matter to it."""
    if not (options.live or options.live_connect or options.live_out):
        yield
        return
    from skewmi.cli.live_flags import live_options
    from skewmi.cli.train_live import LiveTraining

    console = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)
    if options.live_out is not None:
        check_output(options.live_out, overwrite=options.overwrite)
    live = live_options(options.live, options.live_connect, options.live_out, console.print)
    assert live is not None
    with LiveTraining.start(live, options.run_dir) as view:
        try:
            yield
        finally:
            note = view.close()
            if note:
                console.print(note)
