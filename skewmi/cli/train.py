"""Learn a task from its sparse reward with Skew-Explore, in a run directory.

Writes config.json, metrics.csv, tb/ (TensorBoard) and checkpoints/ into the run directory. An
interrupted run continues with --resume exactly as if it had not been.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from skewmi.cli.task_flags import OptionalTaskName, variation_option
from skewmi.errors import CheckpointError, ConfigurationError
from skewmi.sim import tasks
from skewmi.train import run
from skewmi.train.checkpoint import read_checkpoint, read_run_header
from skewmi.train.config import TrainConfig
from skewmi.train.presets import preset
from skewmi.train.run import TrainResult


@dataclass(frozen=True)
class TrainCommand:
    """Options of `skewmi train`."""

    run_dir: Path
    """Directory of the run; created."""
    task: OptionalTaskName = None
    """Task to learn. Not needed with --resume."""
    preset: Literal["improved", "paper"] = "improved"
    """Where all numbers start from: ours, or the publication's."""
    seed: int = 0
    """Of networks, sampling and environment."""
    resume: bool = False
    """Continue the run in the directory, or start it if there is none yet."""
    start_from: Path | None = None
    """Begin with the networks and the replay of another run, say to go on under a variation;
    its steps count as done."""
    steps: int | None = None
    """Environment steps in total; default: the preset's."""
    minutes: float | None = None
    """Stop after this much wall-clock time, minutes."""
    stop_on_convergence: bool = False
    """Stop when 90 +- 3 % of the last 10 states of the last 10 evaluated trajectories are
    rewarded. Without --steps and --minutes this is the sensible way to end."""
    set: tuple[str, ...] = ()
    """Other numbers than the preset's: SECTION.NAME=VALUE, any of config.json, say
    sac.n_step=1 replay.rare_fraction=0 task_options.gripper_action=true. Values are JSON."""
    num_envs: int | None = None
    """Environments stepped together; default: the preset's."""
    variation: str | None = None
    """How robot and scene differ from the nominal ones: a variation file (YAML), or the name of
    one that comes with the task, as `randomised`. What it says is saved with the run, and --resume
    keeps it."""
    threads: int = 1
    """Threads of the tensor library and of the simulation."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Where the networks live."""
    json: bool = False
    """Print one JSON document on standard output at the end."""
    quiet: bool = False
    """No progress on standard error."""


def with_settings(config: TrainConfig, settings: Sequence[str]) -> TrainConfig:
    """A configuration with some of its numbers replaced.

    Args:
        config: Where from.
        settings: SECTION.NAME=VALUE each, the value as JSON.

    Raises:
        ConfigurationError: There is no such section or name, or the value is not allowed.
    """
    content = json.loads(config.to_json())
    content["task_options"] = dict(content["task_options"])
    sections = [name for name, value in content.items() if isinstance(value, dict)]
    for setting in settings:
        path, equals, text = setting.partition("=")
        section, dot, name = path.partition(".")
        if not (equals and dot) or section not in sections:
            raise ConfigurationError(
                f"--set {setting}: give SECTION.NAME=VALUE with a section of {', '.join(sections)}"
            )
        if section != "task_options" and name not in content[section]:
            raise ConfigurationError(
                f"--set {setting}: {section} has no {name!r}; it has {', '.join(content[section])}"
            )
        try:
            content[section][name] = json.loads(text)
        except json.JSONDecodeError as error:
            raise ConfigurationError(
                f"--set {setting}: {text!r} is not JSON ({error}); write numbers as 0.5, switches "
                'as true or false, words as "prefix"'
            ) from error
    content["task_options"] = list(content["task_options"].items())
    try:
        return TrainConfig.from_json(json.dumps(content))
    except CheckpointError as error:
        raise ConfigurationError(f"--set {' '.join(settings)}: {error}") from error


def begun_from(options: TrainCommand) -> TrainConfig:
    """The configuration of a run that begins with another one's networks and replay."""
    assert options.start_from is not None
    config, _ = read_run_header(options.start_from)
    if options.task not in (None, config.task) or options.set or options.num_envs is not None:
        raise ConfigurationError(
            "--start-from takes task and numbers from the run it names; leave out --task, --set "
            "and --num-envs"
        )
    step = read_checkpoint(options.start_from).state["step"]
    nominal = tuple((k, v) for k, v in config.task_options if k != "variation")
    return replace(
        config,
        started_from=f"{options.start_from.name}, step {step}",
        seed=options.seed,
        device=options.device,
        threads=options.threads,
        task_options=nominal + tuple(variation_option(config.task, options.variation).items()),
    )


def resolve(options: TrainCommand) -> TrainConfig:
    """The configuration that the options mean.

    Raises:
        NotFoundError: No such task or preset.
        ConfigurationError: A value is not allowed, or --variation is not the resumed run's.
        CheckpointError: --resume without --task, and there is no run.
    """
    if options.resume and (options.run_dir / "config.json").exists():
        config, _ = read_run_header(options.run_dir)
        recorded = dict(config.task_options).get("variation")
        given = variation_option(config.task, options.variation).get("variation")
        if options.variation is not None and given != recorded:
            raise ConfigurationError(
                f"--variation {options.variation} is not what the run in {options.run_dir} was "
                "started with; leave --variation out to continue it, or use another directory"
            )
        if options.set:
            raise ConfigurationError(
                f"--set changes a run that exists in {options.run_dir}; leave --set out to "
                "continue it, or use another directory"
            )
    elif options.start_from is not None:
        config = begun_from(options)
    elif options.task is None:
        config, _ = read_run_header(options.run_dir)  # says that there is no run here
    else:
        config = replace(
            preset(options.task, options.preset),
            seed=options.seed,
            device=options.device,
            threads=options.threads,
        )
        extra = tuple(variation_option(options.task, options.variation).items())
        config = replace(config, task_options=config.task_options + extra)
        config = with_settings(config, options.set)
        if options.num_envs is not None:
            evaluation = min(config.rollout.evaluation_envs, max(options.num_envs - 1, 0))
            rollout = replace(config.rollout, num_envs=options.num_envs, evaluation_envs=evaluation)
            config = replace(config, rollout=rollout)
    return replace(
        config,
        total_steps=config.total_steps if options.steps is None else options.steps,
        minutes=options.minutes,
        stop_on_convergence=options.stop_on_convergence,
    )


def train(options: TrainCommand) -> TrainResult:
    """Make the environment and train."""
    config = resolve(options)
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
        options.run_dir,
        resume=options.resume,
        start_from=options.start_from,
        progress=not options.quiet,
    )


def as_text(result: TrainResult) -> str:
    """A few lines for people."""
    lines = [
        f"{result.steps:,} steps, {result.trajectories:,} trajectories in "
        f"{result.seconds / 60:.1f} min (stopped by {result.stopped_by}); run: {result.run_dir}"
    ]
    lines += [
        f"  first {name}: trajectory {first['trajectory']:,}"
        for name, first in result.discoveries.items()
    ]
    converged = (
        f"converged after {result.converged_at:,} trajectories"
        if result.converged_at is not None
        else f"not converged ({result.evaluation_fraction:.0%} of the last states rewarded)"
    )
    return "\n".join([*lines, f"  {converged}"])


def run_train(options: TrainCommand) -> int:
    """Train and print the result. Returns 0."""
    result = train(options)
    print(json.dumps(asdict(result), indent=2) if options.json else as_text(result))
    return 0
