"""What a sweep file says: groups of configurations and the figures made from them, read strictly.

seeds: 5                          # 0 to 4; or a list
threads: 1                        # of each run
set: {total_steps: 400_000}       # numbers of every group
groups:
  NAME:
    tasks: [TASK, ...]
    targets: [TARGET, ...]        # option `target` of the tasks; without: their default
    configurations:               # presets, or names with what they are made of
      - PRESET
      - {name: NAME, preset: PRESET, learner: NAME, exploration: NAME, set: {}, options: {}}
    seeds, set, options           # of this group
    keep_states: true             # visited states of the first seed go into the results
figures:
  NAME: {draw: KIND, groups: [NAME, ...], ...}    # see `skewmi figures`
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.sweep.number_names import by_one_name
from skewmi.yaml_text import parse_yaml

Value = bool | int | float | str | None | list[Any]
"""Of a number that is set, as YAML has it."""

MAX_SEEDS = 10_000
_TOP = ("seeds", "threads", "set", "groups", "figures")
_GROUP = ("tasks", "targets", "configurations", "seeds", "set", "options", "keep_states")
_CONFIGURATION = ("name", "preset", "learner", "exploration", "set", "options")
_T = TypeVar("_T")


@dataclass(frozen=True)
class Configuration:
    """One way to train.

    Attributes:
        name: What results call it.
        preset: Where its numbers start from.
        learner, exploration: In the place of the preset's, with their own numbers; or None.
        numbers: Changed ones, by the dotted names that `TrainConfig` has for them.
        options: Of the task.
    """

    name: str
    preset: str
    learner: str | None
    exploration: str | None
    numbers: Mapping[str, Value]
    options: Mapping[str, Value]


@dataclass(frozen=True)
class Group:
    """Every configuration on every task, target and seed.

    Attributes:
        name: Unique in the file.
        tasks: Their names.
        targets: Values of the option `target`; (None,): the tasks' default.
        configurations: At least one.
        seeds: Of the runs.
        keep_states: Whether visited states of the first seed go into the results.
    """

    name: str
    tasks: tuple[str, ...]
    targets: tuple[str | None, ...]
    configurations: tuple[Configuration, ...]
    seeds: tuple[int, ...]
    keep_states: bool


@dataclass(frozen=True)
class SweepFile:
    """A whole file.

    Attributes:
        text: As it is written.
        threads: Of each run.
        groups: In the file's order.
        figures: By name; only whoever draws them knows what may stand there.
    """

    text: str
    threads: int
    groups: tuple[Group, ...]
    figures: Mapping[str, Any]


def read_sweep_file(path: Path) -> SweepFile:
    """Read a sweep file.

    Raises:
        NotFoundError: There is none.
        ConfigurationError: It cannot be read, or says something that is not allowed.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise NotFoundError(f"there is no sweep file {path}; docs/sweep.md shows one") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"cannot read {path}: {error}") from error
    return parse_sweep(text, str(path))


def parse_sweep(text: str, name: str) -> SweepFile:
    """What the text of a sweep file says; `name` is for messages.

    Raises:
        ConfigurationError: It says something that is not allowed.
    """
    top = _mapping(parse_yaml(text, name), name, _TOP)
    groups = _mapping(top.get("groups"), f"{name}, groups")
    if not groups:
        raise ConfigurationError(f"{name} has no groups, so there is nothing to run")
    seeds = _seeds(top.get("seeds", 1), name)
    numbers = _numbers(top, name)
    threads = _typed(top.get("threads", 1), int, f"{name}, threads")
    return SweepFile(
        text=text,
        threads=threads,
        groups=tuple(
            _group(str(key), value, f"{name}, group {key}", seeds, numbers)
            for key, value in groups.items()
        ),
        figures=_mapping(top.get("figures") or {}, f"{name}, figures"),
    )


@dataclass(frozen=True)
class Part:
    """Which part of a sweep to run or to collect alone.

    Its runs are those of the whole sweep, but where steps are fewer.

    Attributes:
        groups, tasks, configurations: Names of those to keep; none: all.
        seeds: How many of each group's, the first ones; None: all.
        steps: Of every run; None: what the file says.
    """

    groups: Sequence[str] = ()
    tasks: Sequence[str] = ()
    configurations: Sequence[str] = ()
    seeds: int | None = None
    steps: int | None = None


def narrowed(sweep: SweepFile, part: Part) -> SweepFile:
    """A part of a sweep. Groups of which nothing is left are left out.

    Raises:
        NotFoundError: There is no such group, or none of the chosen ones has such a task or
            configuration; or nothing has both.
    """
    _known([group.name for group in sweep.groups], part.groups, "group")
    groups = [group for group in sweep.groups if not part.groups or group.name in part.groups]
    _known([task for group in groups for task in group.tasks], part.tasks, "task")
    names = [c.name for group in groups for c in group.configurations]
    _known(names, part.configurations, "configuration")
    kept = [_part_of(group, part) for group in groups]
    kept = [group for group in kept if group.tasks and group.configurations]
    if not kept:
        raise NotFoundError(
            f"no group has configuration {' or '.join(map(_quoted, part.configurations))} on task "
            f"{' or '.join(part.tasks)}; --dry-run lists the runs that there are"
        )
    return replace(sweep, groups=tuple(kept))


def _part_of(group: Group, part: Part) -> Group:
    configurations = [
        c for c in group.configurations if not part.configurations or c.name in part.configurations
    ]
    if part.steps is not None:
        configurations = [
            replace(c, numbers={**c.numbers, "total_steps": part.steps}) for c in configurations
        ]
    return replace(
        group,
        tasks=tuple(task for task in group.tasks if not part.tasks or task in part.tasks),
        configurations=tuple(configurations),
        seeds=group.seeds if part.seeds is None else group.seeds[: part.seeds],
    )


def _known(known: Sequence[str], asked: Sequence[str], what: str) -> None:
    unknown = [name for name in asked if name not in known]
    if unknown:
        allowed = ", ".join(dict.fromkeys(map(_quoted, known)))
        raise NotFoundError(f"no {what} {', '.join(map(_quoted, unknown))}; {what}s are {allowed}")


def _quoted(name: str) -> str:
    """A name that can be told from its neighbours in a list."""
    return f'"{name}"' if "," in name else name


def _group(
    name: str, content: object, where: str, seeds: tuple[int, ...], numbers: Mapping[str, Value]
) -> Group:
    given = _mapping(content, where, _GROUP)
    numbers = {**numbers, **_numbers(given, where)}
    options = _mapping(given.get("options") or {}, f"{where}, options")
    entries = given.get("configurations")
    if not isinstance(entries, list) or not entries:
        raise ConfigurationError(f"{where}: configurations must be a list of presets or mappings")
    configurations = tuple(_configuration(entry, where, numbers, options) for entry in entries)
    _unique([c.name for c in configurations], f"{where}, configurations")
    targets = given.get("targets")
    return Group(
        name=name,
        tasks=_names(given.get("tasks"), f"{where}, tasks"),
        targets=(None,) if targets is None else _names(targets, f"{where}, targets"),
        configurations=configurations,
        seeds=_seeds(given["seeds"], where) if "seeds" in given else seeds,
        keep_states=_typed(given.get("keep_states", False), bool, f"{where}, keep_states"),
    )


def _configuration(
    entry: object, where: str, numbers: Mapping[str, Value], options: Mapping[str, Value]
) -> Configuration:
    if isinstance(entry, str):
        return Configuration(entry, entry, None, None, numbers, options)
    given = _mapping(entry, f"{where}, configurations", _CONFIGURATION)
    if not isinstance(given.get("preset"), str):
        raise ConfigurationError(f"{where}: a configuration needs a preset, {entry!r} has none")
    for key in ("name", "learner", "exploration"):
        _typed(given.get(key, ""), str, f"{where}, {key}")
    here = f"{where}, configuration {given.get('name', given['preset'])}"
    return Configuration(
        name=given.get("name", given["preset"]),
        preset=given["preset"],
        learner=given.get("learner"),
        exploration=given.get("exploration"),
        numbers={**numbers, **_numbers(given, here)},
        options={**options, **_mapping(given.get("options") or {}, f"{here}, options")},
    )


def _numbers(given: Mapping[str, Any], where: str) -> dict[str, Value]:
    where = f"{where}, set"
    return by_one_name(_mapping(given.get("set") or {}, where), where)


def _mapping(content: object, where: str, allowed: tuple[str, ...] | None = None) -> dict[str, Any]:
    if not isinstance(content, dict):
        raise ConfigurationError(f"{where}: {content!r} is given where a mapping is needed")
    found = {str(key): value for key, value in content.items()}
    unknown = [key for key in found if allowed is not None and key not in allowed]
    if unknown and allowed is not None:
        raise ConfigurationError(
            f"{where}: unknown {', '.join(map(repr, unknown))}; allowed: {', '.join(allowed)}"
        )
    return found


def _typed(value: object, kind: Callable[..., _T], where: str) -> _T:
    if type(value) is not kind:
        raise ConfigurationError(f"{where}: {value!r} is not of type {kind.__name__}")
    return value  # type: ignore[return-value]


def _names(value: object, where: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not value or not all(isinstance(v, str) for v in value):
        raise ConfigurationError(f"{where}: {value!r} is given, a list of names is needed")
    return _unique(value, where)


def _unique(names: list[str], where: str) -> tuple[str, ...]:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigurationError(f"{where}: {', '.join(twice)} is there twice; give other names")
    return tuple(names)


def _seeds(value: object, where: str) -> tuple[int, ...]:
    """Seeds 0 to n - 1 for a number n, or those of a list."""
    if type(value) is int and 1 <= value <= MAX_SEEDS:
        return tuple(range(value))
    fits = isinstance(value, list) and all(type(v) is int and v >= 0 for v in value)
    if not fits or not value or len(set(value)) != len(value):  # type: ignore[arg-type, call-overload]
        raise ConfigurationError(
            f"{where}: seeds {value!r}; give how many (1 to {MAX_SEEDS}), or a list of different "
            "natural numbers"
        )
    return tuple(value)  # type: ignore[arg-type]
