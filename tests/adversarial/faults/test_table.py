"""The table goes on where it was, runs parts, and is written only once every cell was right."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import table
from fault_catalog import ROWS
from fault_cell import GOES_ON, STOPPED, Fault, Observed, Phase
from fault_results import Result, ResultFile, name_of, sources_hash
from fault_rows import EGM_COLUMN, Case, DoesNotApply, Expect, Row

NOT_THERE = DoesNotApply("not there")


def row(name: str) -> Row:
    fine = Expect(GOES_ON)
    return Row(Fault(name, lambda cell: None), fine, fine, NOT_THERE, egm=Expect(STOPPED, "why"))


MATRIX = {"Group A": (row("one"), row("two")), "Group B": (row("three"),)}
EVERY = sorted(
    (case for rows in MATRIX.values() for member in rows for case in member.cases),
    key=lambda case: case.fault.egm,  # bench by bench
)


class Benches:
    """Every cell comes out as expected, but those that a test wants otherwise.

    Args:
        run: Told each cell.
        wrong: Names of cells that come out wrong.
        broken: Names of those that cannot be judged.
    """

    def __init__(self, run: list[str], wrong: set[str], broken: set[str]) -> None:
        self._run, self._wrong, self._broken = run, wrong, broken

    def observe(self, fault: Fault, phase: Phase, expected: Callable[[Observed], bool]) -> Observed:
        column = EGM_COLUMN if fault.egm else phase.value
        name = f"{fault.name}, {column}"
        self._run.append(name)
        assert name not in self._broken, "the arm is elsewhere"
        verdict = STOPPED if fault.egm else GOES_ON
        return Observed("odd" if name in self._wrong else verdict, "that is why", {"jerk": 0.5}, {})

    def close(self) -> None:
        """Nothing to end."""


class Runs:
    """Runs the table over `MATRIX`, in a folder."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch) -> None:
        self.page, self.patch = folder / "faults.md", patch
        patch.setattr(table, "GROUPS", MATRIX)
        patch.setattr(table, "ROWS", [member for rows in MATRIX.values() for member in rows])
        patch.setattr(table, "sources_hash", lambda: "now")

    def __call__(
        self, *options: str, wrong: set[str] = frozenset(), broken: set[str] = frozenset()
    ) -> tuple[int, list[str]]:
        """Exit code, and the cells that were run."""
        run: list[str] = []
        self.patch.setattr(table, "Benches", lambda folder: Benches(run, wrong, broken))
        return table.main(["--out", str(self.page), *options]), run


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Runs:
    return Runs(tmp_path, monkeypatch)


def test_all_at_once(runs: Runs) -> None:
    assert runs() == (table.FINISHED, list(map(name_of, EVERY)))
    assert runs.page.exists()
    assert runs() == (table.FINISHED, [])


def test_in_parts(runs: Runs) -> None:
    assert runs("--columns", "egm")[1] == [f"{n}, {EGM_COLUMN}" for n in ("one", "two", "three")]
    assert runs("--rows", "Group B", "tw")[1] == [
        f"{name}, {phase}" for name in ("two", "three") for phase in ("start motion", "running")
    ]
    assert not runs.page.exists()
    assert runs()[1] == ["one, start motion", "one, running"]
    assert runs.page.exists()


def test_a_wrong_cell_keeps_the_page_from_being_written_and_is_run_again(runs: Runs) -> None:
    wrong, broken = name_of(EVERY[0]), name_of(EVERY[3])
    code, run = runs(wrong={wrong}, broken={broken})
    assert (code, len(run)) == (table.WRONG, len(EVERY))
    assert not runs.page.exists()
    assert runs() == (table.FINISHED, [wrong, broken])


def test_told_to_end_it_goes_on_later(runs: Runs) -> None:
    assert runs("--for-s", "-1") == (table.UNFINISHED, [])
    assert runs("--list") == (table.FINISHED, [])
    assert len(runs()[1]) == len(EVERY)


def result(cell: str, verdict: str = GOES_ON) -> Result:
    return Result(cell, verdict, "said", 0.5, 1.0)


def test_results_are_those_of_the_same_sources_and_whole_lines(tmp_path: Path) -> None:
    path = tmp_path / "cells.jsonl"
    now, before = ResultFile(path, "now"), ResultFile(path, "before")
    assert now.read() == {}
    before.add(result("a"))
    now.add(result("b"))
    with path.open("a") as file:
        file.write('{"sources": "now", "cell": "c", "verd')  # killed while it was written
    now.add(result("d", "odd"))
    now.add(result("d"))
    assert now.read() == {"b": result("b"), "d": result("d")}
    assert before.read() == {"a": result("a")}


def test_hash_is_of_what_decides_how_a_cell_comes_out(tmp_path: Path) -> None:
    product, shows = tmp_path / "skewmi" / "a.py", tmp_path / "tests" / "adversarial" / "table.py"
    for path in (product, shows):
        path.parent.mkdir(parents=True)
        path.write_text("a = 1\n")
    first = sources_hash(tmp_path)
    shows.write_text("a = 2\n")
    assert sources_hash(tmp_path) == first
    product.write_text("a = 2\n")
    assert sources_hash(tmp_path) != first


def test_every_cell_has_a_name_of_its_own() -> None:
    cases: list[Case] = [case for member in ROWS for case in member.cases]
    assert len(set(map(name_of, cases))) == len(cases)
