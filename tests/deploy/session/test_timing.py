"""Percentiles of cycle times."""

from __future__ import annotations

import numpy as np
import pytest

from skewmi.deploy.session.timing import percentiles_ms


def test_percentiles_are_those_of_numpy_in_milliseconds() -> None:
    durations = [n * 1_000_000 for n in range(1, 1001)]
    result = percentiles_ms(durations)
    assert result["p50"] == pytest.approx(500.5)
    assert result["p99.9"] == pytest.approx(np.percentile(np.arange(1, 1001), 99.9))
    assert result["max"] == 1000.0
    assert percentiles_ms([])["p99"] == 0.0
