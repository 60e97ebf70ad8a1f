"""Whether two versions of this package train alike, to the last digit.

    python benchmarks/bit_identity.py between 8d22713 HEAD          # run both, compare
    python benchmarks/bit_identity.py run HEAD --out /tmp/new       # run one version
    python benchmarks/bit_identity.py compare /tmp/old /tmp/new     # compare what was run

A version is a commit of this repository or a directory that holds one (`.` for what is checked
out, with its changes). `run` trains every task for --iterations periods with preset `improved`,
once in one go and once interrupted before the last period and resumed, and refuses if the two
differ. `compare` takes two `metrics.csv` or two directories of `run`, and compares cell by cell
as text: order and formatting count, too. Columns may be renamed or added (it says which were);
columns of wall-clock time are skipped. Exit code 0: alike, 1: not alike.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import os
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from common import REPOSITORY, progress

TASKS = ("open_press_close", "point_maze")
STEPS_PER_ITERATION = 25 * 200
"""Environments of the preset times steps of an episode."""
RESUMED = "-resumed"
"""Suffix of the interrupted run's directory."""


@contextlib.contextmanager
def checked_out(version: str) -> Iterator[Path]:
    """The tree of a commit in a temporary directory, or the directory that was named.

    Raises:
        SystemExit: It is neither.
    """
    if (Path(version) / "skewmi").is_dir():
        yield Path(version).resolve()
        return
    archive = subprocess.run(
        ["git", "-C", str(REPOSITORY), "archive", version], capture_output=True, check=False
    )
    if archive.returncode != 0:
        raise SystemExit(f"{version!r} is neither a directory with skewmi in it nor a commit")
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as tar:
            tar.extractall(folder, filter="data")
        yield Path(folder)


def train(tree: Path, arguments: Sequence[str]) -> None:
    """`skewmi train` of a tree, in an interpreter of its own.

    Raises:
        SystemExit: It failed.
    """
    command = [sys.executable, "-m", "skewmi.cli.main", "train", *arguments, "--quiet"]
    # The tree's package wins over an installed one: its directory comes first.
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    done = subprocess.run(
        command, cwd=tree, env=environment, stdout=subprocess.DEVNULL, check=False
    )
    if done.returncode != 0:
        raise SystemExit(f"`skewmi train {' '.join(arguments)}` in {tree} failed")


def run(tree: Path, out: Path, options: argparse.Namespace) -> bool:
    """Train every task in one go and interrupted. Returns whether the two are alike."""
    alike = True
    for task in options.tasks:
        begin = ["--task", task, "--seed", str(options.seed), "--preset", options.preset]
        whole, parts = out / task, out / f"{task}{RESUMED}"
        last = options.iterations * STEPS_PER_ITERATION
        progress(f"{tree}: {task}, {options.iterations} iterations")
        train(tree, ["--run-dir", str(whole.resolve()), *begin, "--steps", str(last)])
        before = str(last - STEPS_PER_ITERATION)
        train(tree, ["--run-dir", str(parts.resolve()), *begin, "--steps", before])
        train(tree, ["--run-dir", str(parts.resolve()), "--resume", "--steps", str(last)])
        alike &= same(whole / "metrics.csv", parts / "metrics.csv")
    return alike


def read(path: Path) -> tuple[list[str], list[list[str]]]:
    """Header and rows of a table, as text."""
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    return header, rows


def same(one: Path, other: Path) -> bool:
    """Compare two tables column by column and print what differs."""
    (names, rows), (new_names, new_rows) = read(one), read(other)
    print(f"{one} and {other}:")
    added = [name for name in new_names if name not in names]
    if len(new_names) > len(names) and set(names) < set(new_names):
        # The columns of the one are among those of the other: compare these.
        print(f"  added: {', '.join(added)}")
        kept = [new_names.index(name) for name in names]
        new_names, new_rows = names, [[row[k] for k in kept] for row in new_rows]
    shapes = (len(names), len(rows)), (len(new_names), len(new_rows))
    if shapes[0] != shapes[1]:
        print(f"  NOT ALIKE: {shapes[0]} columns and rows against {shapes[1]}")
        return False
    alike = True
    for k, (old, new) in enumerate(zip(names, new_names, strict=True)):
        if old != new:
            print(f"  renamed: {old} -> {new}")
        if old.startswith("seconds"):
            continue
        pairs = [(row[k], new_row[k]) for row, new_row in zip(rows, new_rows, strict=True)]
        differing = [i for i, (a, b) in enumerate(pairs) if a != b]
        if differing:
            first = differing[0]
            alike = False
            print(
                f"  NOT ALIKE: {new} in {len(differing)} of {len(pairs)} rows, first in row "
                f"{first}: {pairs[first][0]} against {pairs[first][1]}"
            )
    timed = sum(name.startswith("seconds") for name in names)
    if alike:
        print(f"  alike: {len(names) - timed} columns, {len(rows)} rows")
    return alike


def compare(one: Path, other: Path) -> bool:
    """Compare two tables, or all of two directories of `run`.

    Raises:
        SystemExit: There is nothing to compare.
    """
    if one.is_file() and other.is_file():
        return same(one, other)
    names = sorted(path.parent.name for path in one.glob("*/metrics.csv"))
    found = [name for name in names if (other / name / "metrics.csv").exists()]
    if not found or len(found) < len(names):
        raise SystemExit(f"{one} holds the runs {names}, {other} holds {found} of them")
    alike = [same(one / name / "metrics.csv", other / name / "metrics.csv") for name in found]
    return all(alike)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    running = commands.add_parser("run", help="train every task with one version")
    running.add_argument("version", help="commit or directory")
    running.add_argument("--out", type=Path, required=True, help="directory for the runs")
    comparing = commands.add_parser("compare", help="compare two tables or directories")
    comparing.add_argument("one", type=Path)
    comparing.add_argument("other", type=Path)
    between = commands.add_parser("between", help="run two versions and compare")
    between.add_argument("versions", nargs=2, help="commits or directories")
    for command in (running, between):
        command.add_argument("--iterations", type=int, default=3)
        command.add_argument("--seed", type=int, default=0)
        command.add_argument("--preset", default="improved")
        command.add_argument("--tasks", nargs="+", default=TASKS)
    options = parser.parse_args()
    if options.command == "compare":
        return 0 if compare(options.one, options.other) else 1
    if options.command == "run":
        with checked_out(options.version) as tree:
            return 0 if run(tree, options.out, options) else 1
    with tempfile.TemporaryDirectory() as folder:
        outs = [Path(folder) / str(k) for k in range(2)]
        alike = True
        for version, out in zip(options.versions, outs, strict=True):
            with checked_out(version) as tree:
                alike &= run(tree, out, options)
        return 0 if compare(*outs) and alike else 1


if __name__ == "__main__":
    sys.exit(main())
