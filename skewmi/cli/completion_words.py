"""What may be typed after each command, as its own parser says."""

from __future__ import annotations

import argparse
import importlib
import re
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import tyro

from skewmi import policies
from skewmi.cli.main import COMMANDS, options_of
from skewmi.robot_models.limits import PROFILES
from skewmi.sim import tasks

_CHOICES = re.compile(r"\{([^{}]+)\}")
_POLICY = "policy"
_FILE = "file"


@dataclass(frozen=True)
class Flag:
    """One option.

    Attributes:
        names: As they are typed, such as --seed.
        help: Its first sentence.
        takes_value: Whether a value follows.
        values: What the value may be; empty if that is not known.
        takes_path: Whether the value is a file or folder.
    """

    names: tuple[str, ...]
    help: str
    takes_value: bool
    values: tuple[str, ...] = ()
    takes_path: bool = False


@dataclass(frozen=True)
class Entry:
    """What may follow a command.

    Attributes:
        command: Words that lead there, such as ("calibrate", "scene"); empty: `skewmi` itself.
        help: One line.
        flags: Its options.
        words: What may come that is no option: further commands, choices, bundled policies.
        takes_path: Whether files may come, too.
    """

    command: tuple[str, ...]
    help: str
    flags: tuple[Flag, ...] = ()
    words: tuple[str, ...] = ()
    takes_path: bool = False


def every_entry() -> list[Entry]:
    """All commands; those whose packages are not installed have no options."""
    top = (Flag(("--help",), "commands", False), Flag(("--version",), "version", False))
    entries = [Entry((), "", top, tuple(COMMANDS))]
    for name, line in COMMANDS.items():
        try:
            parser = _parser(name)
        except ModuleNotFoundError as error:
            if error.name is not None and error.name.split(".")[0] == "skewmi":
                raise
            entries.append(Entry((name,), line))
            continue
        entries += _entries(parser, (name,), line)
    return entries


def _parser(name: str) -> argparse.ArgumentParser:
    module = importlib.import_module(f"skewmi.cli.{name.replace('-', '_')}")
    defaults = getattr(module, "default_options", None)
    with warnings.catch_warnings():
        # The library means to have another way one day; a test notices when this one is gone.
        warnings.simplefilter("ignore", DeprecationWarning)
        parser = tyro.extras.get_parser(
            options_of(name, module),
            prog=f"skewmi {name}",
            default=defaults([]) if defaults else tyro.MISSING_NONPROP,
        )
    assert isinstance(parser, argparse.ArgumentParser)
    return parser


def _entries(
    parser: argparse.ArgumentParser, command: tuple[str, ...], line: str
) -> Iterator[Entry]:
    flags: list[Flag] = []
    words: list[str] = []
    takes_path = False
    deeper: list[Entry] = []
    for action in parser._actions:
        if isinstance(action.choices, dict):
            for name, parser_of_step in action.choices.items():
                words.append(name)
                description = (parser_of_step.description or "").strip().split("\n")[0]
                deeper += _entries(parser_of_step, (*command, name), description)
        elif action.option_strings:
            flags.append(_flag(action))
        else:
            values = _values(action)
            bundled = action.dest.endswith((_POLICY, _FILE)) and command[0] != "calibrate"
            words += [*values, *(policies.bundled() if bundled else ())]
            takes_path = takes_path or not values
    yield Entry(command, line, tuple(flags), tuple(words), takes_path)
    yield from deeper


def _flag(action: argparse.Action) -> Flag:
    takes_value = action.nargs != 0
    metavar = str(action.metavar or "")
    return Flag(
        tuple(name for name in action.option_strings if name.startswith("--")),
        _sentence(action.help or ""),
        takes_value,
        _values(action),
        takes_value and "PATH" in metavar,
    )


def _values(action: argparse.Action) -> tuple[str, ...]:
    """What an argument may be, as its help shows it."""
    if action.choices:
        return tuple(map(str, action.choices))
    if action.dest in _NAMED:
        return _NAMED[action.dest]()
    metavar: Any = action.metavar
    found = _CHOICES.findall(metavar if isinstance(metavar, str) else "")
    words = [word for group in found for word in re.split(r"[,|]", group)]
    return tuple(word for word in words if word not in ("None", ""))


def _variations() -> tuple[str, ...]:
    names = [spec.variations.bundled() for spec in map(tasks.find, tasks.names())]
    return tuple(sorted({name for every in names for name in every}))


def _presets() -> tuple[str, ...]:
    from skewmi.train import presets

    specs = map(tasks.find, tasks.names())
    names = [presets.names(spec.name, spec.presets) for spec in specs]
    return tuple(dict.fromkeys(name for every in names for name in every))


_NAMED: dict[str, Callable[[], tuple[str, ...]]] = {
    "variation": _variations,
    "preset": _presets,
    "limits": lambda: tuple(PROFILES),
}
"""What some options may be, by their name."""


def _sentence(text: str) -> str:
    plain = " ".join(re.sub(r"\[/?[a-z ]+\]", "", text).split())
    return re.split(r"(?<=[.;:])\s|\s\(default", plain)[0].rstrip(".;:")[:80]
