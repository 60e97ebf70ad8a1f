"""What tests of sweeps share."""

from __future__ import annotations

import pytest

from skewmi.policy_io import PolicyLayout
from skewmi.sim import tasks


@pytest.fixture(scope="session")
def layout() -> PolicyLayout:
    return tasks.find("point_maze").layout()
