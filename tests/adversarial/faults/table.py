"""Run the whole matrix and write docs/faults.md: `python tests/adversarial/faults/table.py`.

Takes about seven minutes. Writes nothing, and returns 1, if a cell came out otherwise than the
catalogue says.
"""

from __future__ import annotations

import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from fault_benches import Benches
from fault_catalog import ROWS, DoesNotApply
from fault_cell import Phase
from fault_page import PAGE, render


def tell(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def run_matrix() -> bool:
    """Run every cell; whether each was as expected."""
    good = True
    with tempfile.TemporaryDirectory() as folder, closing(Benches(Path(folder))) as benches:
        for row in ROWS:
            for phase in Phase:
                expect = row.cell(phase)
                if isinstance(expect, DoesNotApply):
                    continue
                started = time.monotonic()
                observed = benches.observe(row.fault, phase, expect.matches)
                right = expect.matches(observed)
                good = good and right
                tell(
                    f"{'ok ' if right else 'BAD'} {row.fault.name}, {phase.value}: "
                    f"{observed.verdict} ({time.monotonic() - started:.1f} s, largest share of a "
                    f"limit {max(observed.shares.values()):.6f})"
                )
                if not right:
                    tell(f"    expected {expect.text()}; heard {observed.said}")
    return good


if __name__ == "__main__":
    if not run_matrix():
        sys.exit(1)
    PAGE.write_text(render())
    tell(f"written: {PAGE}")
