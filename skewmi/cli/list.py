"""What there is by name: tasks, bundled policies, robots, presets and variations.

Other commands take these names: `train --task`, `train --preset`, `deploy POLICY`,
`robot --backend`, `--variation`. Presets are only told where training is installed.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.padding import Padding

from skewmi import policies
from skewmi.deploy.robot.backends import BACKENDS
from skewmi.deploy.robot.process import EMULATOR
from skewmi.extras import install_line
from skewmi.sim import tasks

ROBOTS = {
    "sim": "the simulated YuMi with its scene (the default)",
    "hold": "an arm without physics or scene, that is where it is told to be",
    "egm": "bridge to a real controller by externally guided motion",
    EMULATOR: "that bridge, and a controller that is emulated",
}


@dataclass(frozen=True)
class ListCommand:
    """Options of `skewmi list`."""

    json: bool = False
    """Print one JSON document."""


def run_list(options: ListCommand) -> int:
    """Tell what there is. Returns 0."""
    document = inventory()
    if options.json:
        print(json.dumps(document))
    else:
        _print(document, Console())
    return 0


def inventory() -> dict[str, Any]:
    """What there is, by kind and name."""
    return {
        "tasks": {name: _task(name) for name in tasks.names()},
        "policies": {name: {"file": str(path)} for name, path in policies.bundled().items()},
        "robots": {name: ROBOTS.get(name, "of another package") for name in (*BACKENDS, EMULATOR)},
    }


def _task(name: str) -> dict[str, Any]:
    spec = tasks.find(name)
    return {
        "robot": spec.arm is not None,
        "targets": list(spec.targets),
        "options": list(spec.layout_switches),
        "presets": _presets(name),
        "variations": list(spec.variations.bundled()),
    }


def _presets(task: str) -> list[str] | None:
    """Names; None where training is not installed."""
    try:
        from skewmi.train import presets
    except ModuleNotFoundError as error:
        if error.name is not None and error.name.split(".")[0] == "skewmi":
            raise
        return None
    return list(presets.names(task, tasks.find(task).presets))


def _print(document: dict[str, Any], console: Console) -> None:
    def tell(name: str, value: object, indent: int = 2) -> None:
        console.print(Padding(f"[bold]{name}[/bold]  {escape(str(value))}", (0, 0, 0, indent)))

    console.print("tasks")
    for name, told in document["tasks"].items():
        presets = told["presets"]
        tell(name, "" if told["robot"] else "(no robot in it: it is not deployed)")
        tell(
            "presets",
            f"not installed: {install_line('train')}" if presets is None else _words(presets),
            6,
        )
        for kind in ("variations", "targets"):
            if told[kind]:
                tell(kind, _words(told[kind]), 6)
    for kind in ("policies", "robots"):
        console.print(kind)
        for name, told in document[kind].items():
            tell(name, told["file"] if isinstance(told, dict) else told)


def _words(names: list[str]) -> str:
    return ", ".join(names)
