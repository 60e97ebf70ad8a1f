"""What `structure.py` counts in a checkout, and by which rules.

Every rule reads sources alone, so that it judges a tree of any age: nothing is imported.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

TASK_WORDS = (
    *("open_press_close", "OpenPressClose", "point_maze", "PointMaze"),
    *("lid_hinge", "button_slide", "lid_angle", "button_depth"),
)
"""Tasks, their joints and the fields of these; folders of further tasks add their own names."""

LONG_FUNCTION, LONG_CLASS, LONG_FILE = 60, 200, 300
ROOTS = ("skewmi", "tests", "benchmarks")

_GRID_NAME = re.compile(r"grid|cycle|tick|period|due|(^|_)dt$", re.IGNORECASE)
_GRID_VALUES = (0.004, 4_000_000, 0.02, 20_000_000)
_PARTS = {"q", "v", "a"}


@dataclass(frozen=True)
class Source:
    """A Python file of the tree."""

    path: PurePosixPath
    text: str
    tree: ast.Module


def read_sources(root: Path) -> list[Source]:
    """All Python files below the folders `ROOTS`, sorted by path."""
    found = []
    for path in sorted(p for folder in ROOTS for p in (root / folder).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        found.append(Source(PurePosixPath(path.relative_to(root)), text, ast.parse(text)))
    return found


def within(sources: list[Source], *folders: str) -> list[Source]:
    """Those inside of a folder."""
    return [s for s in sources if any(s.path.is_relative_to(folder) for folder in folders)]


def count(sources: list[Source]) -> dict[str, dict[str, Any]]:
    """Every count by its name: "count", and "found", where it was found.

    Counts of length and of benchmarks' names have a "count" per folder of `ROOTS`.
    """
    package = within(sources, "skewmi")
    found: dict[str, Any] = {
        "files_that_name_a_task": files_that_name_a_task(package),
        "forms_of_a_chunk": forms_of_a_chunk(package),
        "definitions_of_grid_and_cycle": definitions_of_grid_and_cycle(package),
        "folder_circles_in_deploy": folder_circles(package, "skewmi.deploy"),
        "test_files_that_import_benchmarks": files_that_import_benchmarks(sources),
    }
    result = {name: {"count": len(items), "found": items} for name, items in found.items()}
    for name, rule in (
        (f"functions_over_{LONG_FUNCTION}_lines", long_functions),
        (f"classes_over_{LONG_CLASS}_lines", long_classes),
        (f"files_over_{LONG_FILE}_lines", long_files),
    ):
        by_root = {root: rule(within(sources, root)) for root in ROOTS}
        counts = {root: len(items) for root, items in by_root.items()}
        result[name] = {"count": counts, "found": by_root}
    return result


def files_that_name_a_task(package: list[Source]) -> list[str]:
    """Files in whose text, comments included, one of `TASK_WORDS` or a task's folder's name is.

    Left out are the tasks' own folders, the presets, and files that lie directly in
    `skewmi/sim/tasks` (the registry). A task's folder is one with a `task.py` below `skewmi/sim`,
    or any folder in `skewmi/sim/tasks`.
    """
    registry = PurePosixPath("skewmi/sim/tasks")
    folders = {
        s.path.parent
        for s in within(package, "skewmi/sim")
        if s.path.name == "task.py" or s.path.parent.parent == registry
    }
    words = {*TASK_WORDS, *(folder.name for folder in folders)}
    pattern = re.compile("|".join(re.escape(word) for word in sorted(words)))
    found = []
    for source in package:
        inside = any(source.path.is_relative_to(folder) for folder in folders)
        exempt = "preset" in str(source.path) or source.path.parent == registry
        named = sorted(set(pattern.findall(source.text)))
        if named and not inside and not exempt:
            found.append(f"{source.path}: {', '.join(named)}")
    return found


def forms_of_a_chunk(package: list[Source]) -> list[str]:
    """Ways in which positions, velocities and accelerations travel together on the way to a robot.

    In `skewmi/deploy` but its `replay`, which draws, and in the modules directly in `skewmi`:

    - a class (protocols and named tuples, too) with members q, v and a, be they fields, properties
      or attributes; private ones do not travel;
    - a class with a field `chunk`, which puts one of the former into yet another;
    - a tuple of three arrays written out in the annotation of a parameter, of a result or of an
      alias. All of these together are one form.
    """
    found, tuples = [], []
    for source in package:
        directly = source.path.parent == PurePosixPath("skewmi")
        replay = source.path.is_relative_to("skewmi/deploy/replay")
        if not directly and (replay or not source.path.is_relative_to("skewmi/deploy")):
            continue
        classes = [node for node in ast.walk(source.tree) if isinstance(node, ast.ClassDef)]
        found += [
            f"{source.path}: {node.name}"
            for node in classes
            if _members(node) >= _PARTS or "chunk" in _fields(node)
        ]
        tuples += [f"{source.path}:{line}" for line in _triples(source.tree)]
    return found + ([f"tuple of three arrays ({', '.join(tuples)})"] if tuples else [])


def definitions_of_grid_and_cycle(package: list[Source]) -> list[str]:
    """Places that give a name the value of the 4 ms grid or the 20 ms cycle as a number.

    The name is that of a variable, attribute or parameter (its default), or of a keyword argument;
    it must have to do with grid, cycle, tick, period, due or dt. Values are 0.004 and 0.02 s,
    4,000,000 and 20,000,000 ns, 4 and 20 for names in `_ms`, and 5 for names in `_ticks`.
    """
    found = []
    for source in package:
        for line, name, value in sorted(_named_numbers(source.tree)):
            lower = name.lower()
            exact = (
                value in _GRID_VALUES
                or (lower.endswith("_ms") and value in (4, 20))
                or (lower.endswith("_ticks") and value == 5)
            )
            # What is bounded by a cycle's length, but is none.
            if exact and _GRID_NAME.search(name) and not lower.startswith(("max_", "min_")):
                found.append(f"{source.path}:{line}: {name} = {value}")
    return found


def folder_circles(package: list[Source], parent: str) -> list[str]:
    """Pairs of folders directly in a package that import each other, by any imports in any place.

    A module that lies directly in the package counts as a folder of its own.
    """
    edges: set[tuple[str, str]] = set()
    prefix = PurePosixPath(parent.replace(".", "/"))
    for source in within(package, str(prefix)):
        own = source.path.relative_to(prefix).parts[0].removesuffix(".py")
        for name in _imported(source.tree):
            if name.startswith(f"{parent}."):
                edges.add((own, name.removeprefix(f"{parent}.").split(".")[0]))
    circles = {tuple(sorted(edge)) for edge in edges if edge[::-1] in edges and len({*edge}) == 2}
    return [" <-> ".join(pair) for pair in sorted(circles)]


def files_that_import_benchmarks(sources: list[Source]) -> list[str]:
    """Test files that import a module which only the folder `benchmarks` has."""
    tests = within(sources, "tests")
    own = {s.path.stem for s in tests} | {s.path.parent.name for s in tests}
    names = {s.path.stem for s in within(sources, "benchmarks")} - own | {"benchmarks"}
    found = []
    for source in tests:
        imported = sorted({name.split(".")[0] for name in _imported(source.tree)} & names)
        if imported:
            found.append(f"{source.path}: {', '.join(imported)}")
    return found


def long_functions(sources: list[Source]) -> list[str]:
    """Functions and methods of more than 60 lines, decorators left out."""
    return _long(sources, (ast.FunctionDef, ast.AsyncFunctionDef), LONG_FUNCTION)


def long_classes(sources: list[Source]) -> list[str]:
    """Classes of more than 200 lines, decorators left out."""
    return _long(sources, (ast.ClassDef,), LONG_CLASS)


def long_files(sources: list[Source]) -> list[str]:
    """Files of more than 300 lines."""
    lengths = [(s.path, len(s.text.splitlines())) for s in sources]
    return [f"{path}: {length}" for path, length in lengths if length > LONG_FILE]


def _long(sources: list[Source], kinds: tuple[type[ast.AST], ...], longest: int) -> list[str]:
    found = []
    for source in sources:
        for node in ast.walk(source.tree):
            if isinstance(node, kinds):
                length = node.end_lineno - node.lineno + 1
                if length > longest:
                    found.append(f"{source.path}: {node.name}, {length}")
    return found


def _fields(node: ast.ClassDef) -> set[str]:
    """Annotated names in the body of a class."""
    return {
        item.target.id
        for item in node.body
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)
    }


def _members(node: ast.ClassDef) -> set[str]:
    """Fields, methods and properties of a class, and attributes that its methods assign."""
    names = _fields(node)
    for item in node.body:
        if not isinstance(item, ast.FunctionDef):
            continue
        names.add(item.name)
        names |= {
            part.attr
            for part in ast.walk(item)
            if isinstance(part, ast.Attribute)
            and isinstance(part.ctx, ast.Store)
            and isinstance(part.value, ast.Name)
            and part.value.id == "self"
        }
    return names


def _triples(tree: ast.Module) -> Iterator[int]:
    """Lines where an alias, a parameter or a result is a tuple of three arrays."""
    annotations: list[ast.AST | None] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            arguments = node.args
            every = (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)
            annotations += [node.returns, *(argument.annotation for argument in every)]
    annotations += [node.value for node in tree.body if isinstance(node, ast.Assign)]
    for annotation in annotations:
        for node in ast.walk(annotation) if annotation is not None else ():
            if (
                isinstance(node, ast.Subscript)
                and isinstance(node.value, ast.Name)
                and node.value.id == "tuple"
                and isinstance(node.slice, ast.Tuple)
                and [ast.unparse(part).split("[")[0] for part in node.slice.elts]
                in (["Array"] * 3, ["NDArray"] * 3)
            ):
                yield node.lineno


def _named_numbers(tree: ast.Module) -> Iterator[tuple[int, str, float]]:
    """Line, name and value wherever a name is given a number."""
    pairs: list[tuple[str, ast.AST | None]] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            pairs += [(ast.unparse(target), node.value) for target in node.targets]
        elif isinstance(node, ast.AnnAssign | ast.AugAssign):
            pairs.append((ast.unparse(node.target), node.value))
        elif isinstance(node, ast.keyword) and node.arg is not None:
            pairs.append((node.arg, node.value))
        elif isinstance(node, ast.arguments):
            every = (*node.posonlyargs, *node.args)
            with_default = every[len(every) - len(node.defaults) :]
            pairs += [(a.arg, d) for a, d in zip(with_default, node.defaults, strict=True)]
            pairs += [(a.arg, d) for a, d in zip(node.kwonlyargs, node.kw_defaults, strict=True)]
    for name, value in pairs:
        if isinstance(value, ast.Constant) and type(value.value) in (int, float):
            yield value.lineno, name.split(".")[-1], value.value


def _imported(tree: ast.Module) -> Iterator[str]:
    """Full names of what a file imports, wherever in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None and not node.level:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
