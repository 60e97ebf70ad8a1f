"""Run the commands of README and pages one after another, as somebody does who reads them.

    python tests/walk_documents.py --out results/walk.json
    python tests/walk_documents.py --pages README.md usage.md

Each page gets a folder of its own, with the files that its text presupposes and nothing else; what
a command writes is there for the next one. A robot server is started when a page speaks to one.
What takes hours is cut short, and what needs what is not here is left out; the document says of
every command what was run instead, or why nothing was. Exit code 1 if a command ended otherwise
than it may.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parent / "support"))

import result_document
from test_documented_commands import PAGES, commands_of
from unknown_robots import exact_calibration

from skewmi import policies
from skewmi.calibration.calibration_file import write_calibration

ROOT = Path(__file__).resolve().parents[1]
SKEWMI = [sys.executable, "-P", "-m", "skewmi.cli.main"]
LOCAL = "tcp/127.0.0.1:7447"
SERVER = f"robot --backend sim --task open_press_close --listen {LOCAL}"
LONGEST_S = 400.0
LOOKED_AT_S = 30.0
"""How long a viewer is left open."""

LEFT_OUT = (
    (r"--engine ray", "needs a Ray cluster; tests/sweep has one of two nodes"),
    (r"figures runs/paper-reduced", "its sweep takes days; tests/sweep draws a small one"),
    (r"--backend own_robot", "its package has to be installed; tests/examples does that"),
    (
        r"runs/press|press\.onnx|press\.mcap",
        "its task has to be installed; tests/examples does that",
    ),
)
CHANGED = (
    (r"\bPOLICY\b", "open_press_close"),
    (r"\bLOCATOR\b|tcp/robot:7447", LOCAL),
    (r"--host robot\.lab", "--host 127.0.0.1 robot.lab"),
    (r"--episodes 500", "--episodes 50"),
    (r"^(train .*?)( --stop-on-convergence)?$", r"\1 --minutes 0.3"),
    (r"^(sweep (?!.*--dry-run).*)$", r"\1 --dry-run"),
)
"""Placeholders, and what would take hours: minutes of training, plans of sweeps."""
MAY_FAIL = ("deploy", "evaluate", "calibrate")
"""Exit code 1 is no fault of theirs: the policy of a minute fails, and so does identifying."""
ON_THE_SCREEN = ("play",)


def prepare(page: Path, folder: Path) -> None:
    """The files that a page speaks of as the reader's own."""
    if page.name == "security.md":  # which exports no policy before it deploys one
        shutil.copy(policies.locate("open_press_close"), folder / "policy.onnx")
    for name in ("robot.yaml", "my-robot.yaml", "mine.yaml"):
        (folder / name).write_text("servo: {kp_scale: 0.9, delay_ms: 10}\n")
    write_calibration(folder / "calibration.yaml", exact_calibration(kp_scale=0.9, delay_ms=10.0))
    write_calibration(folder / "cal.yaml", exact_calibration())  # of the nominal robot
    for name in ("robot", "commander"):
        (folder / name).symlink_to(Path("link") / name)
    (folder / "sweeps").symlink_to(ROOT / "sweeps")


@contextmanager
def served(command: str, folder: Path) -> Iterator[str]:
    """A robot server while the block lasts; yields its last words if it did not get ready."""
    with (folder / "server.txt").open("w") as words:
        child = subprocess.Popen(
            [*SKEWMI, *command.split(), "--json"],
            cwd=folder, stdout=subprocess.PIPE, stderr=words, text=True,
        )  # fmt: skip
        try:
            assert child.stdout is not None
            first = child.stdout.readline()
            yield "" if first.startswith("{") else (folder / "server.txt").read_text()
        finally:
            child.send_signal(signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                child.wait(60.0)
            child.kill()


def changed(command: str) -> str:
    """What is run for a documented command."""
    for pattern, other in CHANGED:
        command = re.sub(pattern, other, command)
    return command


def run(command: str, folder: Path) -> tuple[int, str]:
    """Exit code (or -1: it had to be ended), and the last line of its errors."""
    seconds = LOOKED_AT_S if command.split()[0] in ON_THE_SCREEN else LONGEST_S
    # Views are for a computer without a screen here: they tell an address and end with their run.
    bare = {k: v for k, v in os.environ.items() if "DISPLAY" not in k}
    child = subprocess.Popen(
        [*SKEWMI, *command.split()],
        cwd=folder, env=bare, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    try:
        told, _ = child.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        child.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            child.communicate(timeout=30.0)
        child.kill()
        return (0 if command.split()[0] in ON_THE_SCREEN else -1), f"ended after {seconds:.0f} s"
    return child.returncode, (told.strip().splitlines() or [""])[-1]


def walk(page: Path, folder: Path) -> Iterator[dict[str, Any]]:
    """Run a page's commands in a folder."""
    prepare(page, folder)
    serving = None
    for line in dict.fromkeys(commands_of(page)):
        command = line.removeprefix("skewmi ").strip()
        found: dict[str, Any] = {"page": page.name, "command": line}
        why = next((why for pattern, why in LEFT_OUT if re.search(pattern, command)), None)
        if why is not None:
            yield found | {"left_out": why}
            continue
        if changed(command) != command:
            command = found["run_instead"] = changed(command)
        started = time.monotonic()
        serves = command.startswith("robot")
        if serves or (f"--connect {LOCAL}" in command and serving is None):
            if serving is not None:
                serving.__exit__(None, None, None)
            serving = served(command if serves else SERVER, folder)
            trouble = serving.__enter__()
            if serves:
                code = 2 if trouble else 0
                yield found | {"code": code, "told": trouble, "right": not trouble}
                continue
        if "other.mcap" in command and (folder / "r1.mcap").exists():
            shutil.copy(folder / "r1.mcap", folder / "other.mcap")
        code, told = run(command, folder)
        right = code == 0 or (code == 1 and command.split()[0] in MAY_FAIL)
        seconds = round(time.monotonic() - started, 1)
        yield (
            found
            | {"code": code, "seconds": seconds, "right": right}
            | ({} if right and code == 0 else {"told": told})
        )
    if serving is not None:
        serving.__exit__(None, None, None)


def main() -> int:
    parser = result_document.argument_parser((__doc__ or "").splitlines()[0])
    parser.add_argument("--pages", nargs="*", default=[], help="names; default: all")
    options = parser.parse_args()
    results = []
    for page in PAGES:
        if page.suffix != ".md" or (options.pages and page.name not in options.pages):
            continue
        with tempfile.TemporaryDirectory(prefix="skewmi-walk-") as folder:
            for result in walk(page, Path(folder)):
                result_document.progress(json.dumps(result))
                results.append(result)
    ran = [result for result in results if "code" in result]
    figures = {
        "commands": len(results),
        "run": len(ran),
        "of_these_changed": sum("run_instead" in result for result in ran),
        "left_out": len(results) - len(ran),
        "wrong": [result for result in ran if not result["right"]],
        "each": results,
    }
    document = result_document.write_result("walk", figures, options.out, seed=options.seed)
    result_document.print_result(document, as_json=options.json)
    return 1 if figures["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
