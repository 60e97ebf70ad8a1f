"""Every fault in every phase: the arm rests within its limits, says why, and can be used again."""

from __future__ import annotations

import pytest
from fault_benches import Benches
from fault_catalog import ROWS, DoesNotApply, Row
from fault_cell import Phase
from fault_page import PAGE, render

CELLS = [
    pytest.param(
        row,
        phase,
        id=f"{row.fault.name}-{phase.value}",
        marks=() if phase is row.hardest else pytest.mark.slow,
    )
    for row in ROWS
    for phase in Phase
    if not isinstance(row.cell(phase), DoesNotApply)
]


@pytest.mark.parametrize(("row", "phase"), CELLS)
def test_fault_ends_as_the_page_says(benches: Benches, row: Row, phase: Phase) -> None:
    expect = row.cell(phase)
    assert not isinstance(expect, DoesNotApply)
    try:
        observed = benches.observe(row.fault, phase, expect.matches)
    except RuntimeError as error:
        pytest.skip(str(error))
    assert expect.matches(observed), (expect, observed.verdict, observed.said)


def test_page_is_that_of_the_catalogue() -> None:
    assert PAGE.read_text() == render(), "run: python tests/adversarial/faults/table.py"


def test_every_fault_is_tried_fast_once() -> None:
    assert all(not isinstance(row.cell(row.hardest), DoesNotApply) for row in ROWS)
