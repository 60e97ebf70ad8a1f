"""The counts of `benchmarks/structure.py`, in a small tree with one of everything."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "benchmarks" / "structure.py"

FILES = {
    # A task's own folder, the registry and presets may name it; a comment elsewhere may not.
    "skewmi/sim/tasks/open_drawer/scene.py": "NAME = 'open_drawer'",
    "skewmi/sim/tasks/registry.py": "TASKS = ('open_drawer',)",
    "skewmi/train/presets.py": "PRESETS = {'open_drawer': 1}",
    "skewmi/cli/demo.py": "# As open_drawer does.",
    # Two forms: a class, and all the tuples together. Private members do not travel.
    "skewmi/trajectory.py": """
GRID_NS = 4_000_000
class Plan:
    q: Array
    @property
    def v(self): ...
    def __init__(self): self.a = 1
class Inside:
    def __init__(self): self._q = self._v = self._a = 1
def step(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]: ...
def wait(period_ms: int = 20, patience_s: float = 0.02, *, cycle_dt: float = 0.02): ...
""",
    # A circle, one half of which is hidden in a function; `motion` only looks on.
    "skewmi/deploy/robot/server.py": "from skewmi.deploy.session import run",
    "skewmi/deploy/session/run.py": """
def start():
    from skewmi.deploy.robot.server import Server
""",
    "skewmi/deploy/motion/planner.py": "import skewmi.deploy.robot.server",
    "skewmi/deploy/long.py": (
        "class Long:\n    def long(self):\n" + "        1\n" * 60 + "    x = 0\n" * 240
    ),
    "tests/test_speed.py": "import speed",
    "tests/test_support.py": "import helper, json",
    "tests/support/helper.py": "",
    "benchmarks/speed.py": "",
    "benchmarks/helper.py": "",
}
EXPECTED: dict[str, Any] = {
    "files_that_name_a_task": 1,
    "forms_of_a_chunk": 2,
    "definitions_of_grid_and_cycle": 3,
    "folder_circles_in_deploy": 1,
    "test_files_that_import_benchmarks": 1,
    "functions_over_60_lines": {"skewmi": 1, "tests": 0, "benchmarks": 0},
    "classes_over_200_lines": {"skewmi": 1, "tests": 0, "benchmarks": 0},
    "files_over_300_lines": {"skewmi": 1, "tests": 0, "benchmarks": 0},
}


def structure(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("tree")
    for name, text in FILES.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return root


def test_everything_is_counted_once(tree: Path, tmp_path: Path) -> None:
    out = tmp_path / "structure.json"
    done = structure("--before", str(tree), "--tree", str(tree), "--json", "--out", str(out))
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document == json.loads(out.read_text(encoding="utf-8"))
    assert document["before"] == document["after"]
    counts = {name: document["after"][name]["count"] for name in EXPECTED}
    assert counts == EXPECTED
    assert set(document["after"]) == {"commit", *EXPECTED}


def test_people_see_where_each_is(tree: Path) -> None:
    text = structure("--tree", str(tree)).stdout
    for found in (
        "skewmi/cli/demo.py: open_drawer",
        "skewmi/trajectory.py: Plan",
        "cycle_dt = 0.02",
        "robot <-> session",
        "tests/test_speed.py: speed",
        "long, 61",
        "Long, 302",
    ):
        assert found in text
    for innocent in ("registry.py", "Inside", "patience_s", "motion", "helper"):
        assert innocent not in text


def test_a_tree_that_is_none_is_refused(tmp_path: Path) -> None:
    done = structure("--tree", str(tmp_path))
    assert done.returncode == 1
    assert "neither the folder of a checkout" in done.stderr
