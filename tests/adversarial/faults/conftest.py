"""Makes the modules of this folder importable, and lends benches to run cells on."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from fault_benches import Benches


@pytest.fixture(scope="module")
def benches(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Benches]:
    # Not "package": this folder is none to pytest, and the last bench, two busy robot servers,
    # would run beside all tests that follow.
    lent = Benches(tmp_path_factory.mktemp("faults"))
    yield lent
    lent.close()
