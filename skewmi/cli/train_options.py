"""The options of `skewmi train`, and the configuration that they mean."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from skewmi.cli import numbers
from skewmi.cli.policies import task_options
from skewmi.cli.task_flags import OptionalTaskName, variation_option
from skewmi.errors import ConfigurationError
from skewmi.sim import tasks
from skewmi.train.checkpoint import read_checkpoint, read_run_header
from skewmi.train.config import MetricsConfig, RolloutConfig, TrainConfig
from skewmi.train.exploration.protocol import ExplorationConfig
from skewmi.train.learner import LearnerConfig
from skewmi.train.presets import DEFAULT, default_preset, preset
from skewmi.train.registry import EXPLORATIONS, LEARNERS, default_config, entry_of
from skewmi.train.run import started_from

MAX_STEPS = 10**12

_HELP = "Another {} than the preset's, with its own default numbers: {}."


@dataclass(frozen=True)
class Origin:
    """The options that decide where a run's numbers start from."""

    run_dir: Path
    """Directory of the run; created."""
    task: OptionalTaskName = None
    """Task to learn. Not needed with --resume."""
    preset: str | None = None
    """Where all numbers start from: `improved` is ours and the default, `paper` the
    publication's."""
    learner: Annotated[
        str | None, tyro.conf.arg(help=_HELP.format("learner", ", ".join(LEARNERS)))
    ] = None
    exploration: Annotated[
        str | None, tyro.conf.arg(help=_HELP.format("exploration", ", ".join(EXPLORATIONS)))
    ] = None
    resume: bool = False
    """Continue the run in the directory, or start it if there is none yet."""
    start_from: Path | None = None
    """Begin with the networks and the episodes of another run, say to go on under a variation;
    its steps count as done."""


@dataclass(frozen=True)
class Numbers:
    """The numbers of a run that depend on how it learns."""

    learner: LearnerConfig
    """What learns."""
    exploration: ExplorationConfig
    """What says where to go, and what that is worth."""
    rollout: RolloutConfig
    """How episodes are collected and kept."""
    metrics: MetricsConfig
    """How it is measured what was visited."""


@dataclass(frozen=True)
class TrainCommand(Origin):
    """Options of `skewmi train`."""

    seed: int | None = None
    """Of networks, sampling and environment; default: 0."""
    steps: int | None = None
    """Environment steps in total; default: the preset's."""
    minutes: float | None = None
    """Stop after this much wall-clock time, minutes."""
    stop_on_convergence: bool = False
    """Stop when 90 +- 3 % of the last 10 states of the last 10 evaluated trajectories are
    rewarded. Without --steps and --minutes this is the sensible way to end."""
    num_envs: int | None = None
    """Environments stepped together; default: the preset's."""
    option: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Option of the task, NAME=VALUE with VALUE in JSON, as time_input=true; may be repeated."""
    variation: str | None = None
    """How robot and scene differ from the nominal ones: a variation file (YAML), or the name of
    one that comes with the task, as `randomised`. What it says is saved with the run, and --resume
    keeps it."""
    threads: int | None = None
    """Threads of the tensor library and of the simulation; default: 1."""
    device: Literal["cpu", "cuda"] | None = None
    """Where the networks live; default: cpu."""
    json: bool = False
    """Print one JSON document on standard output at the end."""
    quiet: bool = False
    """No progress on standard error."""
    numbers: Annotated[Numbers, tyro.conf.arg(name="")] = field(kw_only=True)
    """All other numbers of the run."""


def numbers_of(config: TrainConfig) -> Numbers:
    """The numbers of a configuration that have flags of their own."""
    return Numbers(config.learner, config.exploration, config.rollout, config.metrics)


def starting_config(task: str, name: str = DEFAULT) -> TrainConfig:
    """A preset of a task, with what is to be measured in it.

    Raises:
        NotFoundError: No such task or preset.
        ConfigurationError: The task's own preset is none.
    """
    spec = tasks.find(task)
    return replace(preset(task, name, spec.presets), task_metrics=spec.metrics)


def origin_config(origin: Origin) -> TrainConfig:
    """The configuration that a run's numbers start from: of a run, a preset, or all defaults.

    Raises:
        NotFoundError: No such task, preset, learner or exploration.
        CheckpointError: The run that is named is none.
    """
    if origin.resume and (origin.run_dir / "config.json").exists():
        return read_run_header(origin.run_dir)[0]
    if origin.start_from is not None:
        return read_run_header(origin.start_from)[0]
    config = (
        default_preset("")
        if origin.task is None
        else starting_config(origin.task, origin.preset or DEFAULT)
    )
    if origin.learner is not None:
        config = replace(config, learner=default_config(LEARNERS, origin.learner))
    if origin.exploration is not None:
        config = replace(config, exploration=default_config(EXPLORATIONS, origin.exploration))
    return config


def default_options(arguments: Sequence[str]) -> TrainCommand:
    """What the options are where `arguments` say nothing: it depends on some of the options.

    Raises:
        NotFoundError, CheckpointError: See `origin_config`.
    """
    origin, _ = tyro.cli(
        Origin,
        args=arguments,
        default=Origin(run_dir=Path()),
        return_unknown_args=True,
        add_help=False,
    )
    return TrainCommand(run_dir=tyro.MISSING, numbers=numbers_of(origin_config(origin)))


def changed_flags(numbers: Numbers, config: TrainConfig) -> list[str]:
    """Flags of the numbers that are not a configuration's."""
    flags = []
    for part in fields(numbers):
        ours, theirs = getattr(numbers, part.name), getattr(config, part.name)
        if type(ours) is not type(theirs):
            flags.append(f"--{part.name}")
            continue
        names = [number.name for number in fields(ours)]
        changed = [name for name in names if getattr(ours, name) != getattr(theirs, name)]
        flags += [f"--{part.name}.{name.replace('_', '-')}" for name in changed]
    return flags


def _refuse_changes(
    options: TrainCommand, config: TrainConfig, why: str, **more: tuple[object, object]
) -> None:
    """What a run began with cannot change; to say the same again is no change.

    Args:
        options: What is asked for; None was not said.
        config: Of the run.
        why: Ends the message.
        more: Name of an option -> what it says (None: nothing), and what the run has.

    Raises:
        ConfigurationError: An option says something else than the run has; both are told.
    """
    compared = {
        "task": (options.task, config.task),
        "preset": (options.preset, config.preset),
        "learner": (options.learner, entry_of(config.learner)[0]),
        "exploration": (options.exploration, entry_of(config.exploration)[0]),
        "num-envs": (options.num_envs, config.rollout.num_envs),
        **{name.replace("_", "-"): pair for name, pair in more.items()},
    }
    flags = changed_flags(options.numbers, config)
    flags += [
        f"--{name} {given} (the run has {has})"
        for name, (given, has) in compared.items()
        if given is not None and given != has
    ]
    recorded = dict(config.task_options)
    flags += [
        f"--option {name}={json.dumps(value)} (the run has {json.dumps(recorded.get(name))})"
        for name, value in task_options(config.task, None, options.option).items()
        if recorded.get(name) != value
    ]
    if flags:
        raise ConfigurationError(f"leave out {', '.join(flags)}: {why}")


def begun_from(options: TrainCommand, config: TrainConfig) -> TrainConfig:
    """The configuration of a run that begins with another one's networks and episodes."""
    assert options.start_from is not None
    why = f"--start-from takes task and numbers from the run in {options.start_from}"
    _refuse_changes(options, config, why)
    origin = started_from(options.start_from, read_checkpoint(options.start_from))
    nominal = tuple((k, v) for k, v in config.task_options if k != "variation")
    return replace(
        config,
        started_from=origin,
        seed=options.seed or 0,
        device=options.device or "cpu",
        threads=1 if options.threads is None else options.threads,
        task_options=nominal + tuple(variation_option(config.task, options.variation).items()),
    )


def resumed(options: TrainCommand, config: TrainConfig) -> TrainConfig:
    """The configuration of a run that goes on."""
    why = f"the run in {options.run_dir} goes on with what it began with; or use another directory"
    start_from = options.start_from
    _refuse_changes(
        options,
        config,
        why,
        seed=(options.seed, config.seed),
        threads=(options.threads, config.threads),
        device=(options.device, config.device),
        start_from=(
            None if start_from is None else start_from.resolve().name,
            config.started_from.rpartition(", step ")[0] or "none",
        ),
    )
    recorded = dict(config.task_options).get("variation")
    given = variation_option(config.task, options.variation).get("variation")
    if options.variation is not None and given != recorded:
        raise ConfigurationError(
            f"--variation {options.variation} is not what the run in {options.run_dir} was "
            "started with; leave --variation out to continue it, or use another directory"
        )
    return config


def begun(options: TrainCommand, config: TrainConfig) -> TrainConfig:
    """The configuration of a run from scratch."""
    rollout = options.numbers.rollout
    if options.num_envs is not None:
        evaluation = min(rollout.evaluation_envs, max(options.num_envs - 1, 0))
        rollout = replace(rollout, num_envs=options.num_envs, evaluation_envs=evaluation)
    given = task_options(config.task, None, options.option)
    for name, value in given.items():
        if not isinstance(value, bool | int | float | str):
            raise ConfigurationError(
                f"--option {name}: {value!r} is not a number, a word or true or false"
            )
    varied = variation_option(config.task, options.variation)
    return replace(
        config,
        seed=options.seed or 0,
        device=options.device or "cpu",
        threads=1 if options.threads is None else options.threads,
        task_options=tuple({**dict(config.task_options), **given, **varied}.items()),
        learner=options.numbers.learner,
        exploration=options.numbers.exploration,
        rollout=rollout,
        metrics=options.numbers.metrics,
    )


def _check_numbers(options: TrainCommand) -> None:
    if options.seed is not None:
        numbers.require_seed(options.seed)
    numbers.require("--steps", options.steps, 1, MAX_STEPS)
    numbers.require_positive("--minutes", options.minutes)
    numbers.require("--num-envs", options.num_envs, 1, numbers.MAX_ENVS)
    numbers.require("--threads", options.threads, 1, numbers.MAX_THREADS)


def resolve(options: TrainCommand) -> TrainConfig:
    """The configuration that the options mean.

    Raises:
        NotFoundError: No such preset, learner or exploration.
        ConfigurationError: A value is not allowed, or would change a run that goes on.
        CheckpointError: --resume without --task, and there is no run.
    """
    _check_numbers(options)
    config = origin_config(options)
    if options.resume and (options.run_dir / "config.json").exists():
        config = resumed(options, config)
    elif options.start_from is not None:
        config = begun_from(options, config)
    elif options.task is None:
        read_run_header(options.run_dir)  # says that there is no run here
    else:
        config = begun(options, config)
    return replace(
        config,
        total_steps=config.total_steps if options.steps is None else options.steps,
        minutes=options.minutes,
        stop_on_convergence=options.stop_on_convergence,
    )
