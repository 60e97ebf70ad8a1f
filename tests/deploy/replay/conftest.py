"""A recording for the tests of a module."""

from __future__ import annotations

from pathlib import Path

import pytest
from recorded_motion import write_recording


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("replay") / "run.mcap"
    write_recording(path)
    return path
