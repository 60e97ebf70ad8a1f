"""`skewmi COMMAND ...`: finds the command, parses its options, turns errors into exit codes.

Exit codes: 0 done, 1 stopped before the end or failed a check, 2 bad input or environment,
130 interrupted. How many episodes succeed is a result, not a failure. Errors that the user can
mend are one line on standard error.
"""

from __future__ import annotations

import importlib
import os
import sys
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from types import ModuleType
from typing import Any

import tyro

from skewmi import __version__, extras
from skewmi.errors import NotFoundError, SkewmiError, did_you_mean
from skewmi.matrix_kernels import take_fast_kernels

COMMANDS: dict[str, str] = {
    "demo": "deploy a policy on the simulated YuMi, film and replay it; train another",
    "train": "learn a task from its sparse reward",
    "sweep": "train many runs from one file, on this machine or a Ray cluster",
    "evaluate": "success rate of a run or ONNX file in the batched simulation",
    "figures": "learning curves and visited states of a run; figures and tables of a sweep",
    "export-onnx": "write a run's policy as one self-describing ONNX file",
    "robot": "start a robot server (the simulated YuMi)",
    "deploy": "run an ONNX policy on a robot server",
    "home": "lead the arm to where its task starts, or to its home pose",
    "jog": "move the arm by one small step",
    "calibrate": "identify one robot: excite, servo, scene, report, ranges",
    "stop": "bring the arm smoothly to rest",
    "replay": "turn a recording into a Rerun file, or show it live",
    "play": "show a policy in simulation: in Rerun or in the browser, no deployment",
    "film": "draw an episode of a recording: film and strip of frames",
    "export-dataset": "recordings as a data set for imitation learners (LeRobot)",
    "list": "tasks, policies, robots, presets and variations by name",
    "info": "what a policy, recording, calibration or run is",
    "model": "the robot model as URDF or MJCF",
    "completion": "completion of commands and options in bash, zsh or fish",
    "certificates": "certificates and Zenoh configurations for a link between machines",
    "doctor": "what works on this machine",
}
"""Command -> one line of help. `a-b` lives in module `a_b` as `ABCommand` and `run_a_b`."""


DRAWS_NOTHING = frozenset({"deploy", "home", "jog", "robot", "stop"})
"""Commands that need no OpenGL."""

_NO_OPENGL = "disabled"
"""A value of MUJOCO_GL."""

FORMER_FLAGS = {"--twin": "--variation"}
"""Flags of former versions, which still work but are no longer told, and what they are now."""


def usage() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {line}" for name, line in COMMANDS.items()]
    return "\n".join(
        [
            "usage: skewmi COMMAND [options]      (skewmi COMMAND --help: options and units)",
            "",
            *lines,
            "",
            "  --version, --help",
        ]
    )


def run_command(name: str, arguments: list[str]) -> int:
    """Parse `arguments` for command `name` and run it.

    Raises:
        NotFoundError: There is no such command.
        SkewmiError: Whatever the command raises about its input.
    """
    if name not in COMMANDS:
        raise NotFoundError(
            f"unknown command {name!r}; commands are {', '.join(COMMANDS)}"
            f"{did_you_mean(name, COMMANDS)}"
        )
    try:
        with _without_opengl() if name in DRAWS_NOTHING else nullcontext():
            _load_mujoco_safely()
            return _run(name, arguments)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] in ("", "skewmi"):
            raise
        # Whatever a command needs beyond what every installation has, it imports when it needs it.
        raise extras.missing(f"`skewmi {name}`", error) from error


def _run(name: str, arguments: list[str]) -> int:
    module_name = name.replace("-", "_")
    if name == "train" and not {"-h", "--help"} & set(arguments):
        take_fast_kernels()  # before its module imports torch
    module = importlib.import_module(f"skewmi.cli.{module_name}")
    options_type = options_of(name, module)
    run = getattr(module, f"run_{module_name}")
    arguments = [_present_name(argument) for argument in arguments]
    description = textwrap.dedent(module.__doc__ or "")
    # Where the defaults of some options depend on others, the command's module says how.
    defaults = getattr(module, "default_options", None)
    options = tyro.cli(
        options_type,
        prog=f"skewmi {name}",
        description=description,
        args=arguments,
        default=defaults(arguments) if defaults else tyro.MISSING_NONPROP,
    )
    return int(run(options))


def options_of(name: str, module: ModuleType) -> Any:
    """The dataclass of a command's options, in its module."""
    return getattr(module, "".join(part.title() for part in name.split("-")) + "Command")


def _present_name(argument: str) -> str:
    """An argument with the present name of a flag in place of a former one."""
    flag, equals, value = argument.partition("=")
    return f"{FORMER_FLAGS.get(flag, flag)}{equals}{value}"


def main(arguments: list[str] | None = None) -> int:
    """Entry point of the `skewmi` command. Returns the exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(usage())
        return 0 if arguments else 2
    if arguments[0] == "--version":
        print(f"skewmi {__version__}")
        return 0
    try:
        code = run_command(arguments[0], arguments[1:])
        # Here, where a full disk or a closed pipe behind standard output can still be told.
        sys.stdout.flush()
        return code
    except SkewmiError as error:
        print(f"skewmi {arguments[0]}: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"skewmi {arguments[0]}: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # The reader (head, less) went away; leave quietly, as other tools do.
        _discard_output()
        return 0
    except OSError as error:
        # Whatever else the machine refuses: a full disk, a missing right, a broken file system.
        where = f" ({error.filename})" if error.filename is not None else ""
        reason = error.strerror or " ".join(str(error).split())
        print(f"skewmi {arguments[0]}: {reason}{where}", file=sys.stderr)
        _discard_output()
        return 2


@contextmanager
def _without_opengl() -> Iterator[None]:
    """While the block runs, MuJoCo loads no window system when it is imported.

    To find one takes it a quarter of a second. Pictures that this process draws afterwards get
    theirs all the same (`sim.offscreen`).
    """
    chosen = os.environ.get("MUJOCO_GL")
    if sys.platform != "linux":
        yield
        return
    os.environ["MUJOCO_GL"] = _NO_OPENGL
    try:
        yield
    finally:
        del os.environ["MUJOCO_GL"]
        if chosen is not None:
            os.environ["MUJOCO_GL"] = chosen


def _load_mujoco_safely() -> None:
    """Import MuJoCo without MUJOCO_GL if that is set.

    MuJoCo loads the platform that it names when it is imported, and cannot be imported without
    it; most commands draw nothing. Those that do look at the variable when they draw
    (`sim.offscreen`).
    """
    if os.environ.get("MUJOCO_GL", _NO_OPENGL) == _NO_OPENGL:
        return
    chosen = os.environ.pop("MUJOCO_GL")
    try:
        with suppress(ImportError):
            importlib.import_module("mujoco")
    finally:
        os.environ["MUJOCO_GL"] = chosen


def _discard_output() -> None:
    """What is left in standard output's buffer goes nowhere, instead of failing at exit."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    sys.exit(main())
