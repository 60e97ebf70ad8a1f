"""Counts of how the project is built: what is named twice, what is tangled, what is too long.

    python benchmarks/structure.py
    python benchmarks/structure.py --tree ../another/checkout --json
    python benchmarks/structure.py --before 8d22713 --out results/structure.json

A tree is the folder of a checkout, or a commit of this repository; the rules (`structure_counts`)
are the same for all. With --before, the document holds both trees' counts.
"""

from __future__ import annotations

import io
import subprocess
import sys
import tarfile
import tempfile
from itertools import chain
from pathlib import Path
from typing import Any

from common import REPOSITORY, argument_parser, print_result, write_result
from structure_counts import ROOTS, count, read_sources


def counts_of(tree: str) -> dict[str, Any]:
    """The counts of a folder or of a commit of this repository."""
    if (Path(tree) / "skewmi").is_dir():
        return {"commit": _commit_of(Path(tree)), **count(read_sources(Path(tree)))}
    git = ["git", "-C", str(REPOSITORY)]
    archive = subprocess.run(
        [*git, "archive", "--format=tar", tree, *ROOTS], capture_output=True, check=False
    )
    if archive.returncode != 0:
        sys.exit(
            f"{tree} is neither the folder of a checkout (it has no skewmi/) nor a commit of "
            f"{REPOSITORY}: {archive.stderr.decode().strip()}"
        )
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
            files.extractall(folder, filter="data")
        counts = count(read_sources(Path(folder)))
    commit = subprocess.run(
        [*git, "rev-parse", f"{tree}^{{commit}}"], capture_output=True, text=True, check=True
    )
    return {"commit": commit.stdout.strip(), **counts}


def _commit_of(folder: Path) -> str | None:
    """The commit that is checked out in a folder, with `-dirty` if files differ; None without."""
    git = ["git", "-C", str(folder)]
    head = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=False)
    changed = subprocess.run(
        [*git, "status", "--porcelain", "--", *ROOTS], capture_output=True, text=True, check=False
    )
    if head.returncode or changed.returncode:
        return None
    return head.stdout.strip() + "-dirty" * bool(changed.stdout)


def as_text(trees: dict[str, dict[str, Any]]) -> str:
    """A table of the counts, and below it where they come from in the last tree."""
    *_, last = trees.values()
    names = [name for name in last if name != "commit"]
    width = max(map(len, names))
    lines = [" " * width + "".join(f"{title:>16}" for title in trees)]
    for name in names:
        row = "".join(f"{_short(tree[name]['count']):>16}" for tree in trees.values())
        lines.append(f"{name:<{width}}{row}")
    lines.append(f"(three numbers: {', '.join(ROOTS)})")
    for name in names:
        found = last[name]["found"]
        flat = found if isinstance(found, list) else list(chain(*found.values()))
        if flat:
            lines += ["", f"{name}:", *(f"  {item}" for item in flat)]
    return "\n".join(lines)


def _short(value: int | dict[str, int]) -> str:
    return str(value) if isinstance(value, int) else " / ".join(map(str, value.values()))


def main() -> int:
    parser = argument_parser(__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--tree", default=str(REPOSITORY), help="what to count: folder or commit")
    parser.add_argument("--before", default=None, help="an earlier tree to compare with")
    options = parser.parse_args()
    trees = {} if options.before is None else {"before": counts_of(options.before)}
    trees["after" if options.before is not None else "counts"] = counts_of(options.tree)
    document = write_result("structure", trees, options.out)
    if options.json:
        print_result(document, as_json=True)
    else:
        print(as_text(trees))
    return 0


if __name__ == "__main__":
    sys.exit(main())
