"""Nobody but a task itself knows it by name: a task is a folder and a line in the registry."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import skewmi
from skewmi.sim import tasks

PACKAGE = Path(skewmi.__file__).parent
REGISTRY = PACKAGE / "sim" / "tasks" / "__init__.py"
PRESETS = "train/presets"
"""Its files are named for tasks, because the numbers of a training are about one."""

SUFFIXES = (".py", ".yaml", ".yml", ".json", ".toml", ".txt")


def words_of(name: str) -> list[str]:
    """Patterns for everything that belongs to one task: its name however it is written (snake
    case, CamelCase, with spaces), the joints of its scene, the fields that they are observed as."""
    spec = tasks.find(name)
    parts = r"[\W_]?".join(re.escape(word) for word in name.split("_"))
    return [parts, *map(re.escape, spec.scene_fields), *map(re.escape, spec.scene_fields.values())]


def files_that_name(name: str) -> dict[str, int]:
    """How many lines of each file that is not the task's own name it or what is its own."""
    pattern = re.compile("|".join(words_of(name)), re.IGNORECASE)
    own = PACKAGE / "sim" / "tasks" / name
    found = {}
    for path in sorted(PACKAGE.rglob("*")):
        place = path.relative_to(PACKAGE).as_posix()
        if path.suffix not in SUFFIXES or own in path.parents or place.startswith(PRESETS):
            continue
        lines = sum(bool(pattern.search(line)) for line in path.read_text("utf-8").splitlines())
        if lines:
            found[place] = lines
    return found


@pytest.mark.parametrize("name", [n for n in tasks.names() if (PACKAGE / "sim/tasks" / n).is_dir()])
def test_a_task_is_named_by_its_folder_its_presets_and_one_line_of_the_registry(name: str) -> None:
    assert files_that_name(name) == {REGISTRY.relative_to(PACKAGE).as_posix(): 1}


def test_the_words_of_a_task_are_found_however_they_are_written() -> None:
    name = tasks.default()
    pattern = re.compile("|".join(words_of(name)), re.IGNORECASE)
    camel = "".join(word.capitalize() for word in name.split("_"))
    arm = tasks.find(name).arm
    assert arm is not None
    written = [name, camel, name.replace("_", " "), name.replace("_", "-"), *arm.joint_names]
    assert all(pattern.search(f"# As in {text}, say.") for text in written)
    assert not pattern.search("any other text about tasks and joints")
