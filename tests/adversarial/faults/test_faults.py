"""Every fault in every phase: the arm rests within its limits, says why, and can be used again."""

from __future__ import annotations

import pytest
from fault_benches import Benches
from fault_catalog import ROWS
from fault_cell import Phase
from fault_page import PAGE, render
from fault_rows import Case, Expect, Row

FAST_BEHIND_EGM = ("1 chunk lost", "motors off")
"""Tried fast there: one for the session's side, and one for the controller's."""


def _is_fast(row: Row, case: Case) -> bool:
    if case.fault.egm:
        return row.fault.name in FAST_BEHIND_EGM
    return case.phase is row.hardest


CASES = [
    pytest.param(
        case,
        id=f"{case.fault.name}-{case.column}",
        marks=() if _is_fast(row, case) else pytest.mark.slow,
    )
    for row in ROWS
    for case in row.cases
]


@pytest.mark.parametrize("case", CASES)
def test_fault_ends_as_the_page_says(benches: Benches, case: Case) -> None:
    try:
        observed = benches.observe(case.fault, case.phase, case.expect.matches)
    except RuntimeError as error:
        pytest.skip(str(error))
    assert case.expect.matches(observed), (case.expect, observed.verdict, observed.said)


def test_page_is_that_of_the_catalogue() -> None:
    assert PAGE.read_text() == render(), "run: python tests/adversarial/faults/table.py"


def test_every_fault_is_tried_fast_once() -> None:
    for row in ROWS:
        if any(isinstance(row.cell(phase), Expect) for phase in Phase):
            assert isinstance(row.cell(row.hardest), Expect)
    assert set(FAST_BEHIND_EGM) <= {row.fault.name for row in ROWS}
