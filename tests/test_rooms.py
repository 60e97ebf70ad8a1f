"""Who may import whom inside `deploy`, by its sources: every import counts, wherever it stands."""

from __future__ import annotations

import ast
import functools
from pathlib import Path

import pytest

import skewmi

PACKAGE = Path(skewmi.__file__).parent
EVERYBODY = {"errors", "extras", "trajectory"}
"""What all may import."""

ROOMS: dict[str, set[str]] = {
    "wire": set(),
    "safety": {"policy_io", "robot_models"},
    "motion": {"policy_io", "robot_models", "deploy.safety"},
    "robot": {
        "policy_io",
        "box_frame",
        "robot_models",
        "calibration",
        "contact",
        "child",
        "sim",
        "deploy.wire",
        "deploy.safety",
        "deploy.state_machine",
        "deploy.realtime",
    },
    "session": {
        "policy_io",
        "box_frame",
        "robot_models",
        "calibration",
        "command_integrator",
        "motion_under_way",
        "success",
        "smoothness",
        "deploy.wire",
        "deploy.safety",
        "deploy.motion",
        "deploy.robot",
        "deploy.state_machine",
        "deploy.realtime",
        "deploy.options",
        "deploy.report",
    },
    "recording": {"child", "child_process", "outputs", "deploy.wire"},
    "replay": {
        "contact",
        "policy_io",
        "success",
        "smoothness",
        "robot_models",
        "child",
        "child_process",
        "outputs",
        "privacy",
        "deploy.wire",
        "deploy.recording",
    },
}
"""Room of `deploy` -> what of this package its files may import."""

ROBOT_FOR_SESSIONS = {"description", "states", "status"}
"""What a session needs of the robot's room: words, no robot."""

CALIBRATION_FOR_USERS = {
    "calibration.calibration_file",
    "calibration.calibration_parts",
    "calibration.calibration_use",
    "calibration.calibration_values",
}
"""What whoever uses a calibration needs: its file, and what is made of it; nothing of what makes
one."""

SIMULATORS = ("deploy.robot.backends.mujoco", "deploy.robot.egm_emulator")
"""The only modules of `deploy` that may import the simulation."""


def _exists(module: str) -> bool:
    path = PACKAGE.joinpath(*module.split("."))
    return path.is_dir() or path.with_suffix(".py").is_file()


def _imported(tree: ast.Module) -> set[str]:
    """Modules of ours that are imported anywhere in a file, without the package's name."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    found = set()
    for name in names:
        if name.startswith("skewmi."):
            module = name.removeprefix("skewmi.")
            while not _exists(module):
                module = module.rpartition(".")[0]
            found.add(module)
    return found


@functools.cache
def imports() -> dict[str, set[str]]:
    """Module -> what it imports of the package."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        module = ".".join(parts).removesuffix("__init__").rstrip(".")
        found[module] = _imported(ast.parse(path.read_text(encoding="utf-8")))
    return found


def room(module: str) -> str:
    """The folder or file that a module counts as: in `deploy` the second level, else the first."""
    parts = module.split(".")
    return ".".join(parts[: 2 if parts[0] == "deploy" else 1])


@pytest.mark.parametrize("name", ROOMS)
def test_rooms_import_only_what_the_table_allows(name: str) -> None:
    home = f"deploy.{name}"
    files = {module: found for module, found in imports().items() if room(module) == home}
    assert files
    for module, found in files.items():
        others = {room(other) for other in found} - {home}
        assert others <= ROOMS[name] | EVERYBODY, f"{module} imports {sorted(others)}"


def test_every_folder_of_deploy_is_in_the_table() -> None:
    folders = {path.parent.name for path in (PACKAGE / "deploy").glob("*/__init__.py")}
    assert folders == set(ROOMS)


def test_the_vocabulary_imports_the_errors_alone() -> None:
    assert imports()["errors"] == set()
    assert imports()["extras"] == {"errors"}
    assert imports()["trajectory"] == {"errors"}


def test_a_session_knows_a_robot_by_its_words_alone() -> None:
    for module, found in imports().items():
        if room(module) == "deploy.session":
            of_robot = {other for other in found if room(other) == "deploy.robot"}
            assert of_robot <= {f"deploy.robot.{name}" for name in ROBOT_FOR_SESSIONS}, module


def test_who_uses_a_calibration_knows_its_file_alone() -> None:
    users = 0
    for module, found in imports().items():
        if module.startswith(("sim", "deploy")):
            of_calibration = {other for other in found if room(other) == "calibration"}
            assert of_calibration <= CALIBRATION_FOR_USERS, module
            users += bool(of_calibration)
    assert users


def test_only_simulated_robots_import_the_simulation() -> None:
    users = {
        module
        for module, found in imports().items()
        if room(module).startswith("deploy") and any(room(other) == "sim" for other in found)
    }
    assert users
    assert all(module.startswith(SIMULATORS) for module in users), sorted(users)


def test_sweeps_know_trainings_and_nothing_of_tasks_and_commands() -> None:
    allowed = {"", "train", "child", "outputs", "yaml_text"} | EVERYBODY
    files = {module: found for module, found in imports().items() if room(module) == "sweep"}
    assert files
    for module, found in files.items():
        others = {room(other) for other in found} - {"sweep"}
        assert others <= allowed, f"{module} imports {sorted(others)}"


def test_of_sweeps_pictures_know_the_tables_alone() -> None:
    for module, found in imports().items():
        if room(module) == "evaluation":
            of_sweeps = {other for other in found if room(other) == "sweep"}
            assert of_sweeps <= {"sweep.tables"}, module


def test_no_two_folders_import_each_other_by_whatever_way() -> None:
    edges: dict[str, set[str]] = {}
    for module, found in imports().items():
        if module and module != "deploy":
            here = room(module)
            edges.setdefault(here, set()).update(room(other) for other in found if other)
            edges[here].discard(here)
    settled: set[str] = set()

    def visit(here: str, way: tuple[str, ...]) -> None:
        assert here not in way, " -> ".join([*way[way.index(here) :], here])
        if here not in settled:
            for there in sorted(edges.get(here, ())):
                visit(there, (*way, here))
            settled.add(here)

    for here in edges:
        visit(here, ())
