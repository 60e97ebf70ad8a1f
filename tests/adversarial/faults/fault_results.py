"""Results of finished cells, kept in a file: a run that was interrupted goes on where it was."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from fault_cell import Observed
from fault_rows import Case

REPOSITORY = Path(__file__).parents[3]
_OF_CELLS = ("skewmi", "tests/adversarial", "tests/support")
"""What decides how a cell comes out."""
_NOT_OF_CELLS = ("fault_page.py", "fault_results.py", "table.py")
"""What only chooses, keeps and shows."""


def sources_hash(repository: Path = REPOSITORY) -> str:
    """Of everything that decides how a cell comes out: the package and the programs that try it."""
    digest = hashlib.sha256()
    for path in sorted(_sources(repository)):
        digest.update(path.relative_to(repository).as_posix().encode() + b"\0")
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


def _sources(repository: Path) -> Iterable[Path]:
    for folder in _OF_CELLS:
        for path in (repository / folder).rglob("*"):
            shows = path.name in _NOT_OF_CELLS or path.name.startswith("test_")
            if path.is_file() and "__pycache__" not in path.parts and not shows:
                yield path


def name_of(case: Case) -> str:
    """Of a cell, for people and for the file."""
    return f"{case.fault.name}, {case.column}"


@dataclass(frozen=True)
class Result:
    """A cell that has been run."""

    cell: str
    verdict: str
    said: str
    largest_share: float
    """Of a limit, used by the commanded motion."""
    seconds: float

    @staticmethod
    def of(case: Case, observed: Observed, seconds: float) -> Result:
        share = max(observed.shares.values())
        return Result(name_of(case), observed.verdict, observed.said, share, seconds)


class ResultFile:
    """One line for each finished cell; only those of the same sources are believed.

    Whole lines are appended, so that several runs may fill one file at the same time.

    Args:
        path: Of the file, which need not be there.
        sources: See `sources_hash`.
    """

    def __init__(self, path: Path, sources: str) -> None:
        self._path, self._sources = path, sources

    def read(self) -> dict[str, Result]:
        """Newest result of each cell, by `name_of`; a line that was cut short is left out."""
        found: dict[str, Result] = {}
        lines = self._path.read_text().splitlines() if self._path.exists() else []
        for line in lines:
            try:
                values = json.loads(line)
            except ValueError:
                continue
            if values.pop("sources") == self._sources:
                found[values["cell"]] = Result(**values)
        return found

    def add(self, result: Result) -> None:
        """Keep a result. The file's folder must be there."""
        line = json.dumps({"sources": self._sources, **vars(result)})
        text = self._path.read_text() if self._path.exists() else ""
        cut = "\n" if text and not text.endswith("\n") else ""
        with self._path.open("a") as file:
            file.write(f"{cut}{line}\n")
