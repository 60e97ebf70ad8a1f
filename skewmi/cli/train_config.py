"""The configuration that the options of `skewmi train` mean."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

from skewmi.cli import numbers
from skewmi.cli.policies import locate_policy, task_options
from skewmi.cli.task_flags import calibration_option, variation_option
from skewmi.cli.train_options import TrainCommand, changed_flags, origin_config
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Policy
from skewmi.train.checkpoint import read_checkpoint, read_run_header
from skewmi.train.config import TrainConfig
from skewmi.train.registry import entry_of
from skewmi.train.run import started_from

MAX_STEPS = 10**12

_ROBOT_OPTIONS = ("variation", "calibration")
"""Task options that say what the robot is and what is known of it, each with a flag."""

_ENGINE_FLAG = "--learner.engine"
"""How a learner computes its updates, which a run with another one's networks may do otherwise."""


def _refuse_changes(
    options: TrainCommand,
    config: TrainConfig,
    why: str,
    *,
    but: tuple[str, ...] = (),
    **more: tuple[object, object],
) -> None:
    """What a run began with cannot change; to say the same again is no change.

    Args:
        options: What is asked for; None was not said.
        config: Of the run.
        why: Ends the message.
        but: Flags that may change all the same.
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
    flags = [flag for flag in changed_flags(options.numbers, config) if flag not in but]
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
    if options.teacher is not None:
        raise ConfigurationError(
            "--teacher acts at the beginning of a run from scratch, and --start-from begins with "
            "what another run has learned: leave out one of the two"
        )
    why = f"--start-from takes task and numbers from the run in {options.start_from}"
    _refuse_changes(options, config, why, but=(_ENGINE_FLAG,))
    origin = started_from(options.start_from, read_checkpoint(options.start_from))
    nominal = tuple((k, v) for k, v in config.task_options if k not in _ROBOT_OPTIONS)
    return replace(
        config,
        learner=options.numbers.learner,  # the same but for its engine
        started_from=origin,
        taught_by="",  # it begins with what was learned, whoever taught that
        rewarded=not options.unrewarded,
        seed=options.seed or 0,
        device=options.device or "cpu",
        threads=1 if options.threads is None else options.threads,
        task_options=nominal + tuple(_robot_options(options, config.task).items()),
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
        teacher=(_taught_by(options) or None, config.taught_by or "none"),
        unrewarded=(options.unrewarded or None, not config.rewarded),
        start_from=(
            None if start_from is None else start_from.resolve().name,
            config.started_from.rpartition(", step ")[0] or "none",
        ),
    )
    recorded, given = dict(config.task_options), _robot_options(options, config.task)
    for name in _ROBOT_OPTIONS:
        value = getattr(options, name)
        if value is not None and given.get(name) != recorded.get(name):
            raise ConfigurationError(
                f"--{name} {value} is not what the run in {options.run_dir} was "
                f"started with; leave --{name} out to continue it, or use another directory"
            )
    return config


def _robot_options(options: TrainCommand, task: str) -> dict[str, str]:
    """The task options that say what the robot is and what is known of it."""
    varied = variation_option(task, options.variation)
    return varied | calibration_option(task, options.calibration)


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
    varied = _robot_options(options, config.task)
    return replace(
        config,
        taught_by=_taught_by(options),
        rewarded=not options.unrewarded,
        seed=options.seed or 0,
        device=options.device or "cpu",
        threads=1 if options.threads is None else options.threads,
        task_options=tuple({**dict(config.task_options), **given, **varied}.items()),
        learner=options.numbers.learner,
        exploration=options.numbers.exploration,
        rollout=rollout,
        metrics=options.numbers.metrics,
    )


def load_teacher(options: TrainCommand) -> Policy | None:
    """The policy that --teacher names.

    Raises:
        NotFoundError: There is none of that name.
        PolicyFileError, LayoutMismatchError: It is a file, but no policy.
    """
    if options.teacher is None:
        return None
    from skewmi.deploy.policy import OnnxPolicy  # onnxruntime, for those alone who need it

    return OnnxPolicy.load(_teacher_file(options.teacher))


def _teacher_file(name: str) -> Path:
    path = locate_policy(Path(name), "an ONNX file")
    if not path.is_file():
        raise ConfigurationError(
            f"--teacher {name} is no file; write a run's policy to one with skewmi export-onnx"
        )
    return path


def _taught_by(options: TrainCommand) -> str:
    """What a configuration says of the teacher: its file's name, and what is in it."""
    if options.teacher is None:
        return ""
    path = _teacher_file(options.teacher)
    return f"{path.name}, sha256 {hashlib.sha256(path.read_bytes()).hexdigest()}"


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
