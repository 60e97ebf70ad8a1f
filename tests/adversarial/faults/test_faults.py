"""Every fault in every phase: the arm rests within its limits, says why, and can be used again."""

from __future__ import annotations

import pytest
from fault_benches import Benches, bench_of
from fault_catalog import ROWS
from fault_cell import Phase
from fault_page import PAGE, render
from fault_rows import Case, Expect, Row

STOOD_FOR = {
    "the same joint state again and again": "joint states stop coming",
    "scene states stop coming": "the same scene state again and again",
    "5 chunks lost": "1 chunk lost",
    "20 chunks lost": "50 chunks lost",
    "chunks delayed by 5 ms": "chunks delayed by 50 ms",
    "chunks delayed by 500 ms": "chunks delayed by 50 ms",
    "501 points": "a single point",
    "joints in another order": "six joints",
    "joints of the other arm": "six joints",
    "wall clocks jump by -1 h": "wall clocks jump by +1 h",
    # These topics of strangers have fast tests in deploy/session/test_strangers.py, too.
    "somebody else's scene: lid shut, button pressed": "somebody else's joint states",
    "somebody else's status: in fault": "somebody else's joint states",
    "scene states also from somebody with the same id": (
        "joint states also from somebody with the same id"
    ),
}
"""Rows that only the slow tests try: what the fast ones try in their place."""

FAST_BEHIND_EGM = ("1 chunk lost", "motors off")
"""Tried fast there: one for the session's side, and one for the controller's."""


def _is_fast(row: Row, case: Case) -> bool:
    if case.fault.egm:
        return row.fault.name in FAST_BEHIND_EGM
    return case.phase is row.hardest and row.fault.name not in STOOD_FOR


CASES = [
    pytest.param(
        case,
        id=f"{case.fault.name}-{case.column}",
        marks=() if _is_fast(row, case) else pytest.mark.slow,
    )
    # Those of a bench come together, since starting one takes its time.
    for row, case in sorted(
        ((row, case) for row in ROWS for case in row.cases),
        key=lambda tried: bench_of(tried[1].fault),
    )
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


def test_every_fault_is_tried_fast_or_stood_for() -> None:
    for row in ROWS:
        if any(isinstance(row.cell(phase), Expect) for phase in Phase):
            assert isinstance(row.cell(row.hardest), Expect)
    assert set(FAST_BEHIND_EGM) <= {row.fault.name for row in ROWS}
    names = {row.fault.name for row in ROWS}
    assert set(STOOD_FOR) <= names
    assert set(STOOD_FOR.values()) <= names - set(STOOD_FOR)
    assert not set(STOOD_FOR) & set(FAST_BEHIND_EGM)
