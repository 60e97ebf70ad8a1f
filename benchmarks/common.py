"""What every benchmark shares: the result document, and the way to what tests share with them.

A benchmark is a script `benchmarks/<name>.py` with `--json` (one JSON document on standard output
and nothing else there; progress goes to standard error), `--out FILE` and `--seed N`. Benchmarks
may use what tests use (`tests/support`, `tests/adversarial`), once this is imported; tests import
nothing from here.
"""

from __future__ import annotations

import sys
from pathlib import Path

_TESTS = Path(__file__).resolve().parent.parent / "tests"
sys.path[:0] = [str(_TESTS / "support"), str(_TESTS / "adversarial")]

from result_document import (  # noqa: E402
    REPOSITORY,
    argument_parser,
    commit,
    machine_info,
    print_result,
    progress,
    write_result,
)

__all__ = [
    "REPOSITORY",
    "argument_parser",
    "commit",
    "machine_info",
    "print_result",
    "progress",
    "write_result",
]
