"""From a sweep file to its runs, each once, whatever groups ask for it."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from skewmi.errors import ConfigurationError, SkewmiError
from skewmi.sweep.sweep_file import Configuration, SweepFile
from skewmi.train.checkpoint import read_run_header
from skewmi.train.config import OptionValue, TrainConfig
from skewmi.train.config_json import from_document, to_document
from skewmi.train.registry import EXPLORATIONS, LEARNERS, default_config

PARTS = ("learner", "exploration", "rollout", "metrics")
"""Of a configuration, whose numbers may be set."""
_GIVEN = ("task", "preset", "task_options", "task_metrics", "started_from", "seed", "threads")
SETTABLE = tuple(f.name for f in fields(TrainConfig) if f.name not in (*PARTS, *_GIVEN))
"""Numbers that may be set beside those of its parts; the others the file says in other words."""
RESERVED = ("seed", "num_envs", "num_threads", "variation", "calibration")
"""Options of an environment that a sweep file cannot give."""
TARGET = "target"
"""The task option that says what is rewarded."""

Start = Callable[[str, str], TrainConfig]
"""Task and preset -> the configuration that it is."""


@dataclass(frozen=True)
class Run:
    """One training.

    Attributes:
        name: Of its folder: the same whenever a file asks for the same training.
        config: Resolved.
        changes: What differs from the preset, by dotted name.
    """

    name: str
    config: TrainConfig
    changes: Mapping[str, Any]


@dataclass(frozen=True)
class Member:
    """A run in its place in a group.

    Attributes:
        group, configuration: Names in the file.
        run: Which run; several members may share one.
        keep_states: Whether its visited states go into the results.
    """

    group: str
    configuration: str
    run: Run
    keep_states: bool


@dataclass(frozen=True)
class Plan:
    """All that a sweep file asks for."""

    members: tuple[Member, ...]

    @property
    def runs(self) -> tuple[Run, ...]:
        """Each once, in an order that gives every configuration its first seed first."""
        found = {member.run.name: member.run for member in self.members}
        return tuple(sorted(found.values(), key=lambda run: run.config.seed))


def make_plan(sweep: SweepFile, start: Start) -> Plan:
    """The runs of a sweep file.

    Args:
        sweep: What it says.
        start: Where numbers start from.

    Raises:
        ConfigurationError, NotFoundError: There is no such task, preset, method or number, or a
            value is not allowed; the message says in which group.
    """
    members = []
    for group in sweep.groups:
        for configuration in group.configurations:
            where = f"group {group.name}, configuration {configuration.name}"
            for task in group.tasks:
                for target in group.targets:
                    try:
                        base = _base(configuration, start(task, configuration.preset))
                        config = _resolved(configuration, base, target, sweep.threads)
                    except SkewmiError as error:
                        raise type(error)(f"{where}: {error}") from error
                    changes = _changes(base, config)
                    stem = _stem(configuration, config, changes)
                    for seed in group.seeds:
                        run = Run(f"{stem}-s{seed}", replace(config, seed=seed), changes)
                        keep = group.keep_states and seed == group.seeds[0]
                        members.append(Member(group.name, configuration.name, run, keep))
    return Plan(tuple(members))


def _base(configuration: Configuration, config: TrainConfig) -> TrainConfig:
    """The preset, with other methods in place of its own where that is asked for."""
    for part, entries in (("learner", LEARNERS), ("exploration", EXPLORATIONS)):
        name = getattr(configuration, part)
        if name is not None:
            config = replace(config, **{part: default_config(entries, name)})
    return config


def _resolved(
    configuration: Configuration, base: TrainConfig, target: str | None, threads: int
) -> TrainConfig:
    document = to_document(base)
    for name, value in configuration.numbers.items():
        part, dot, number = name.partition(".")
        if dot and part in PARTS and number in document[part] and number != "name":
            document[part][number] = value
        elif not dot and part in SETTABLE:
            document[part] = value
        else:
            raise ConfigurationError(f"there is no number {name!r}; {_allowed(document, part)}")
    if target is not None and TARGET in configuration.options:
        raise ConfigurationError(
            f"option {TARGET!r} is given beside the group's targets; give one of the two"
        )
    options = dict(configuration.options) | ({} if target is None else {TARGET: target})
    config = from_document(document)
    return replace(
        config, threads=threads, task_options=_options({**dict(config.task_options), **options})
    )


def _allowed(document: Mapping[str, Any], part: str) -> str:
    if part in PARTS:
        names = [f"{part}.{number}" for number in document[part] if number != "name"]
        return f"numbers of {part} are {', '.join(names)}"
    return f"there are {', '.join(SETTABLE)}, and those of {', '.join(f'{p}.*' for p in PARTS)}"


def _options(options: Mapping[str, Any]) -> tuple[tuple[str, OptionValue], ...]:
    for name, value in options.items():
        if name in RESERVED:
            raise ConfigurationError(f"option {name!r} cannot be given in a sweep file")
        if not isinstance(value, bool | int | float | str):
            raise ConfigurationError(
                f"option {name}: {value!r} is not a number, a word or true or false"
            )
    return tuple(options.items())


def _changes(base: TrainConfig, config: TrainConfig) -> dict[str, Any]:
    """What differs from the preset, however the file says it."""
    before, after = flat(to_document(base)), flat(to_document(config))
    changes = {
        key: value
        for key, value in after.items()
        if before.get(key) != value and key not in ("seed", "threads", "task_options")
    }
    return changes | {
        f"task_options.{name}": value
        for name, value in config.task_options
        if (name, value) not in base.task_options
    }


def _stem(configuration: Configuration, config: TrainConfig, changes: Mapping[str, Any]) -> str:
    """The name of a run but for its seed."""
    key = [configuration.preset, configuration.learner, configuration.exploration]
    what = json.dumps([config.task, *key, sorted(changes.items())])
    digest = hashlib.sha256(what.encode()).hexdigest()[:8]
    target = str(dict(config.task_options).get(TARGET, ""))
    words = [config.task, *(word for word in key if word), target, digest]
    return re.sub(r"[^A-Za-z0-9_]+", "-", "-".join(word for word in words if word))


def flat(document: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Numbers of nested mappings by dotted name."""
    found: dict[str, Any] = {}
    for key, value in document.items():
        if isinstance(value, dict):
            found |= flat(value, f"{prefix}{key}.")
        else:
            found[f"{prefix}{key}"] = value
    return found


def require_same_runs(plan: Plan, runs: Path) -> None:
    """See that runs which were begun in a folder are those of a plan.

    A preset may have changed since, and half a run of each makes no result.

    Raises:
        ConfigurationError: One was begun with other numbers; the message names them.
        CheckpointError: One is damaged.
    """
    for run in plan.runs:
        if not (runs / run.name / "config.json").exists():
            continue
        earlier, _ = read_run_header(runs / run.name)
        differing = differences(run.config, replace(earlier, threads=run.config.threads))
        if differing:
            raise ConfigurationError(
                f"the run in {runs / run.name} was begun with {', '.join(differing)}: its preset "
                "or task has changed since; move it away, or give another --out"
            )


def differences(now: TrainConfig, before: TrainConfig) -> list[str]:
    """What a configuration was and now is, a phrase per number; none if they are the same."""
    ours, theirs = flat(to_document(now)), flat(to_document(before))
    return [
        f"{key} {theirs.get(key)} (now {ours.get(key)})"
        for key in {**theirs, **ours}
        if theirs.get(key) != ours.get(key)
    ]
