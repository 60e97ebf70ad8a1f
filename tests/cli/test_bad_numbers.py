"""A number that makes no sense is one line and exit code 2, whatever the command and option."""

from __future__ import annotations

import dataclasses
import importlib
import typing
from pathlib import Path

import pytest

from skewmi.cli import calibrate
from skewmi.cli.main import COMMANDS, main
from skewmi.sim.tasks.registry import MAX_SEED

SMOKE = str(Path(__file__).parents[2] / "sweeps" / "smoke.yaml")
BEFORE: dict[str, list[str]] = {
    "demo": ["--out", "{t}/demo"],
    "train": ["--task", "point_maze", "--run-dir", "{t}/run", "--quiet"],
    "evaluate": ["--agent", "zero", "--task", "point_maze"],
    "figures": ["{r}", "--out", "{t}/figures"],
    "export-onnx": ["{r}", "--out", "{t}/p.onnx"],
    "robot": ["--listen", "tcp/127.0.0.1:1"],
    "deploy": ["open_press_close", "--connect", "tcp/127.0.0.1:1"],
    "stop": ["--connect", "tcp/127.0.0.1:1"],
    "replay": ["{t}/absent.mcap"],
    "film": ["{t}/absent.mcap"],
    "sweep": [SMOKE, "--out", "{t}/sweep"],
    "play": ["open_press_close", "--out", "{t}/play.rrd"],
    "home": ["--connect", "tcp/127.0.0.1:1"],
    "jog": ["--connect", "tcp/127.0.0.1:1", "--z", "5"],
    "export-dataset": ["{t}/absent.mcap", "--out", "{t}/dataset"],
    "list": [],
    "info": ["{t}/absent.mcap"],
    "model": [],
    "completion": ["bash"],
    "certificates": ["--out", "{t}/certificates", "--host", "localhost"],
    "doctor": ["--quick"],
    "calibrate excite": ["--out", "{t}/excitation.mcap"],
    "calibrate servo": ["{t}/absent.mcap", "--out", "{t}/calibration.yaml"],
    "calibrate report": ["{t}/absent.yaml", "--out", "{t}/calibration.html"],
    "calibrate scene": ["--out", "{t}/calibration.yaml"],
    "calibrate ranges": ["{t}/absent.yaml", "--out", "{t}/variation.yaml"],
}
"""What else a command needs; places that it could work with do not exist."""

INTEGERS = ("-1", str(-(2**63)), str(2**80))
FLOATS = ("-1", "nan", "inf", "-inf")
SIGNED = {("jog", name) for name in ("x", "y", "z", "degrees")}
"""Options that may be negative."""


def numeric_options(command: str) -> list[tuple[str, type]]:
    """Options of a command, or of a step of one, that take a number."""
    first, _, step = command.partition(" ")
    module = importlib.import_module(f"skewmi.cli.{first.replace('-', '_')}")
    name = step.title() or "".join(part.title() for part in command.split("-")) + "Command"
    options = getattr(module, name)
    hints = typing.get_type_hints(options)
    found = []
    for field in dataclasses.fields(options):
        kinds = {hints[field.name], *typing.get_args(hints[field.name])}
        name = field.name.replace("_", "-")
        found += [(name, kind) for kind in (int, float) if kind in kinds]
    return found


def steps(command: str) -> list[str]:
    """The command itself, or its steps."""
    if command != "calibrate":
        return [command]
    step = typing.get_type_hints(calibrate.CalibrateCommand)["step"]
    return [f"{command} {kind.__name__.lower()}" for kind in typing.get_args(step)]


CASES = [
    (command, option, value)
    for given in COMMANDS
    for command in steps(given)
    for option, kind in numeric_options(command)
    for value in (INTEGERS if kind is int else FLOATS)
    if not ((command, option) in SIGNED and value == "-1")
]


def test_every_command_is_looked_at() -> None:
    assert set(BEFORE) == {step for command in COMMANDS for step in steps(command)}
    looked_at = {option for _, option, _ in CASES}
    assert {"seed", "dpi", "rate", "port", "domain", "minutes"} <= looked_at


@pytest.mark.parametrize(("command", "option", "value"), CASES)
def test_bad_number_is_one_line(
    command: str,
    option: str,
    value: str,
    tmp_path: Path,
    maze_run: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = [word.format(t=tmp_path, r=maze_run) for word in BEFORE[command]]
    assert main([*command.split(), *words, f"--{option}", value]) == 2
    captured = capsys.readouterr()
    lines = [
        line
        for line in captured.err.splitlines()
        if line.startswith(f"skewmi {command.split()[0]}: ")
    ]
    assert len(lines) == 1, captured.err
    assert "Traceback" not in captured.err
    assert option.replace("-", "_") in lines[0].replace("-", "_"), "names another culprit"


def test_largest_seed_is_allowed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = ["train", "--task", "point_maze", "--run-dir", str(tmp_path / "run"), "--quiet"]
    numbers = ["--steps", "60", "--num-envs", "3", "--seed", str(MAX_SEED)]
    assert main([*run, *numbers]) == 0
