"""The options of `skewmi train`, and where their numbers start from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from skewmi.cli.task_flags import OptionalTaskName
from skewmi.sim import tasks
from skewmi.train.checkpoint import read_run_header
from skewmi.train.config import MetricsConfig, RolloutConfig, TrainConfig
from skewmi.train.exploration.protocol import ExplorationConfig
from skewmi.train.learner import LearnerConfig
from skewmi.train.presets import DEFAULT, default_preset, preset, recommended
from skewmi.train.registry import EXPLORATIONS, LEARNERS, default_config

_HELP = "Another {} than the preset's, with its own default numbers: {}."


@dataclass(frozen=True)
class Origin:
    """The options that decide where a run's numbers start from."""

    run_dir: Path
    """Directory of the run; created."""
    task: OptionalTaskName = None
    """Task to learn. Not needed with --resume."""
    preset: str | None = None
    """Where all numbers start from. Default: `improved-return-then-explore`, the quickest, for the
    tasks that come with it; beside --learner or --exploration `improved`. `paper` is the
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
    """Stop when 90 % of the last 10 states of the last 50 trajectories that count are rewarded,
    known to a standard deviation below 3 %. Without --steps and --minutes the sensible way to
    end."""
    unrewarded: bool = False
    """Explore only: the task has no target and pays nothing. Goes on for the whole budget and
    measures coverage and entropy at every refresh of its goals."""
    teacher: str | None = None
    """A policy that can do something of the task already, say the bundled one under another
    variation: name of a bundled policy, or ONNX file. It acts for the first
    --rollout.taught-steps instead of random actions, and begins a part of the later episodes; the
    learner learns from what it did."""
    num_envs: int | None = None
    """Environments stepped together; default: the preset's."""
    option: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Option of the task, NAME=VALUE with VALUE in JSON, as time_input=true; may be repeated."""
    variation: str | None = None
    """How robot and scene differ from the nominal ones: a variation file (YAML), or the name of
    one that comes with the task, as `randomised`. What it says is saved with the run, and --resume
    keeps it."""
    calibration: Path | None = None
    """What is known of the robot, whatever it is: a calibration file (YAML) of `skewmi calibrate`.
    Its servos get feed-forward from it, and the policy works in the frame of the box it knows.
    Saved and kept like the variation."""
    threads: int | None = None
    """Threads of the tensor library and of the simulation; default: 1."""
    device: Literal["cpu", "cuda"] | None = None
    """Where the networks live; default: cpu."""
    live: bool = False
    """Open a Rerun viewer that shows the training while it goes on: visited states, proposed goals,
    success and coverage. Without a screen it is served for a browser, and the address told. With
    --resume it shows the past, too."""
    live_connect: str | None = None
    """The same in a Rerun viewer that runs somewhere, such as rerun+http://10.0.0.5:9876/proxy."""
    live_out: Path | None = None
    """The same into a Rerun file (.rrd), alone or besides; needs no screen."""
    overwrite: bool = False
    """Replace an existing file of --live-out; never a run."""
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
        else starting_config(origin.task, origin.preset or _preset_of(origin))
    )
    if origin.learner is not None:
        config = replace(config, learner=default_config(LEARNERS, origin.learner))
    if origin.exploration is not None:
        config = replace(config, exploration=default_config(EXPLORATIONS, origin.exploration))
    return config


def _preset_of(origin: Origin) -> str:
    """Preset of somebody who names none.

    Raises:
        NotFoundError: No such task.
    """
    assert origin.task is not None
    if origin.learner is not None or origin.exploration is not None:
        return DEFAULT
    return recommended(origin.task, tasks.find(origin.task).presets)


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
