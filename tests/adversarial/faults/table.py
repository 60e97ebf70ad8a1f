"""Run the whole matrix and write docs/faults.md: `python tests/adversarial/faults/table.py`.

Takes about twenty minutes on a machine with nothing else to do. Writes nothing, and returns 1, if a
cell came out otherwise than the catalogue says. Results of finished cells are kept: a run that was
interrupted, or that was told to end (`--for-s`, then it returns 2), goes on when it is started
again, as long as no source has changed. `--rows` and `--columns` run a part; the page is written
once all parts are there.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[2] / "support"))

from fault_benches import Benches, bench_of
from fault_catalog import GROUPS, ROWS
from fault_cell import Phase
from fault_page import PAGE, render
from fault_results import Result, ResultFile, name_of, sources_hash
from fault_rows import EGM_COLUMN, Case

FINISHED, WRONG, UNFINISHED = 0, 1, 2
COLUMNS = {**{phase.value: phase.value for phase in Phase}, "egm": EGM_COLUMN}


def tell(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def chosen(rows: Sequence[str], columns: Sequence[str]) -> list[Case]:
    """Cells whose row or group has one of `rows` in its name, in one of `columns`; empty: all.

    Those of a bench come together, since starting one takes its time.
    """
    wanted = {COLUMNS[column] for column in columns}
    cases = [
        case
        for group, members in GROUPS.items()
        for row in members
        for case in row.cases
        if not rows or any(part in name for part in rows for name in (group, row.fault.name))
        if not wanted or case.column in wanted
    ]
    return sorted(cases, key=lambda case: bench_of(case.fault))


def run_cell(case: Case, benches: Benches) -> Result | str:
    """Run a cell; what it came to, or what went wrong if it cannot be judged."""
    started = time.monotonic()
    try:
        observed = benches.observe(case.fault, case.phase, case.expect.matches)
    except Exception as error:  # one cell must not keep the others from being run
        return f"{type(error).__name__}: {error}"
    return Result.of(case, observed, time.monotonic() - started)


def run_cells(cases: Sequence[Case], kept: ResultFile, for_s: float) -> int:
    """Run those cells that have no right result yet.

    Args:
        cases: In this order.
        kept: Where results are kept.
        for_s: No cell is begun after so many seconds.

    Returns:
        The exit code.
    """
    code, started = FINISHED, time.monotonic()
    with tempfile.TemporaryDirectory() as folder, closing(Benches(Path(folder))) as benches:
        for number, case in enumerate(cases, start=1):
            before = kept.read().get(name_of(case))
            if before is not None and case.expect.matches(before):
                continue
            if time.monotonic() - started > for_s:
                tell(f"{number - 1} of {len(cases)} cells done; start again to go on")
                return code or UNFINISHED
            result = run_cell(case, benches)
            right = isinstance(result, Result) and case.expect.matches(result)
            mark = "ok " if right else "BAD"
            tell(f"{number}/{len(cases)} {mark} {name_of(case)}: {_short(result)}")
            if isinstance(result, Result):
                kept.add(result)
            if not right:
                code = WRONG
                said = result.said if isinstance(result, Result) else "nothing"
                tell(f"    expected {case.expect.text()}; heard {said}")
    return code


def _short(result: Result | str) -> str:
    if isinstance(result, str):
        return result
    return (
        f"{result.verdict} ({result.seconds:.1f} s, largest share of a limit "
        f"{result.largest_share:.6f})"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", nargs="+", default=[], help="parts of rows' or groups' names")
    parser.add_argument("--columns", nargs="+", default=[], choices=list(COLUMNS))
    parser.add_argument(
        "--list", action="store_true", help="only say which cells, and which are done"
    )
    parser.add_argument("--for-s", type=float, default=float("inf"), help="begin no cell after it")
    parser.add_argument("--out", type=Path, default=PAGE, help="the page")
    parser.add_argument(
        "--state", type=Path, help="where results are kept; beside the page if left out"
    )
    options = parser.parse_args(arguments)
    state = options.state or options.out.with_suffix(".cells.jsonl")
    kept = ResultFile(state, sources_hash())
    cases = chosen(options.rows, options.columns)
    if options.list:
        done = kept.read()
        for case in cases:
            tell(f"{'done' if name_of(case) in done else '    '} {name_of(case)}")
        return FINISHED
    code = run_cells(cases, kept, options.for_s)
    if code != FINISHED:
        return code
    every, done = [case for row in ROWS for case in row.cases], kept.read()
    missing = sum(
        name_of(case) not in done or not case.expect.matches(done[name_of(case)]) for case in every
    )
    if missing:
        tell(f"{missing} of {len(every)} cells are still to be run: nothing is written")
        return FINISHED
    options.out.write_text(render())
    tell(f"written: {options.out}; {state} can go")
    return FINISHED


if __name__ == "__main__":
    sys.exit(main())
