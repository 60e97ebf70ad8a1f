"""What may be typed after each command, as its own options say.

Options come from tyro, by the completion that it writes itself (`--tyro-write-completion`): the
script begins with everything that it knows of them. What is typed without a flag, and what some
values may be, tyro does not tell there; that is read from the commands' dataclasses.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
import typing
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tyro

from skewmi import policies
from skewmi.cli.main import COMMANDS, options_of
from skewmi.errors import ConfigurationError
from skewmi.robot_models.limits import PROFILES
from skewmi.sim import tasks

_CHOICES = re.compile(r"\{([^{}]+)\}")
_POLICY = "policy"
_FILE = "file"
_SPEC = "COMPLETION_SPEC = "
"""Begins the line of tyro's script that has all options as a literal of Python."""


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
    """All commands; those whose packages are not installed have no options.

    Raises:
        ConfigurationError: The installed tyro writes another completion than this knows.
    """
    top = (Flag(("--help",), "commands", False), Flag(("--version",), "version", False))
    entries = [Entry((), "", top, tuple(COMMANDS))]
    for name, line in COMMANDS.items():
        try:
            module = importlib.import_module(f"skewmi.cli.{name.replace('-', '_')}")
            options = options_of(name, module)
            defaults = getattr(module, "default_options", None)
            default = defaults([]) if defaults else tyro.MISSING_NONPROP
        except ModuleNotFoundError as error:
            if error.name is not None and error.name.split(".")[0] == "skewmi":
                raise
            entries.append(Entry((name,), line))
            continue
        entries += _entries(_told_by_tyro(options, default), options, (name,), line)
    return entries


def _told_by_tyro(options: Any, default: Any) -> dict[str, Any]:
    """Options and further commands of a command."""
    with TemporaryDirectory() as folder:
        script = Path(folder) / "completion"
        with suppress(SystemExit):
            written = ["--tyro-write-completion", "bash", str(script)]
            tyro.cli(options, prog="skewmi", default=default, args=written)
        for line in script.read_text(encoding="utf-8").splitlines():
            if line.startswith(_SPEC):
                return dict(ast.literal_eval(line.removeprefix(_SPEC)))
    raise ConfigurationError(
        f"tyro {tyro.__version__} writes its completion in a form that this skewmi does not know; "
        "1.0.17 is known"
    )


def _entries(
    told: Mapping[str, Any], options: Any, command: tuple[str, ...], line: str
) -> Iterator[Entry]:
    words: list[str] = list(told["subcommands"])
    takes_path = False
    steps: dict[str, Any] = {}
    for name, kind in typing.get_type_hints(options, include_extras=True).items():
        steps |= {step.__name__.lower(): step for step in _dataclasses_in(kind)}
        if tyro.conf.Positional in getattr(kind, "__metadata__", ()):
            values = _literals_in(kind)
            bundled = name.endswith((_POLICY, _FILE)) and command[0] != "calibrate"
            words += [*values, *(policies.bundled() if bundled else ())]
            takes_path = takes_path or not values
    flags = tuple(map(_flag, told["options"]))
    yield Entry(command, line, flags, tuple(words), takes_path)
    for name, deeper in told["subcommands"].items():
        step = steps[name]
        description = (inspect.getdoc(step) or "").split("\n")[0]
        yield from _entries(deeper, step, (*command, name), description)


def _dataclasses_in(kind: Any) -> Iterator[Any]:
    """Those that a type is a union of."""
    for part in typing.get_args(kind):
        if isinstance(part, type) and dataclasses.is_dataclass(part):
            yield part
        yield from _dataclasses_in(part)


def _literals_in(kind: Any) -> tuple[str, ...]:
    """What a type of literals admits; nothing of any other type."""
    if typing.get_origin(kind) is typing.Literal:
        return tuple(map(str, typing.get_args(kind)))
    return tuple(value for part in typing.get_args(kind) for value in _literals_in(part))


def _flag(option: Mapping[str, Any]) -> Flag:
    names = tuple(name for name in option["flags"] if name.startswith("--"))
    if option["type"] in ("flag", "boolean"):
        return Flag(names, _sentence(option["description"]), False)
    metavar, _, help_text = option["description"].partition(" • ")
    values = tuple(option.get("choices", ())) or _values(names[0], metavar)
    return Flag(names, _sentence(help_text), True, values, "PATH" in metavar)


def _values(name: str, metavar: str) -> tuple[str, ...]:
    """What an option may be, by its name or as its help shows it."""
    named = name.removeprefix("--").replace("-", "_")
    if named in _NAMED:
        return _NAMED[named]()
    words = [word for group in _CHOICES.findall(metavar) for word in re.split(r"[,|]", group)]
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
