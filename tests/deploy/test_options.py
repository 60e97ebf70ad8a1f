"""Options of a deployment."""

from __future__ import annotations

from typing import Any

import pytest

from skewmi.deploy.options import DeployOptions
from skewmi.errors import (
    ConfigurationError,
)


@pytest.mark.parametrize(
    "changes", [{"episodes": 0}, {"speed": 0.0}, {"speed": float("nan")}, {"start_spread": -1.0}]
)
def test_impossible_options_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError):
        DeployOptions(**changes)


def test_seeds_count_from_zero() -> None:
    with pytest.raises(ConfigurationError, match="seed is -1"):
        DeployOptions(seed=-1)
