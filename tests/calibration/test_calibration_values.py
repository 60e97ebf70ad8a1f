"""Values that a calibration may hand in, from YAML or from JSON."""

from __future__ import annotations

import sys

import pytest

from skewmi.calibration.calibration_values import number_of
from skewmi.errors import ConfigurationError


@pytest.mark.parametrize("value", [10**400, -(10**400), float("nan"), float("-inf"), True, "1"])
def test_what_is_no_finite_number_is_refused_in_one_short_line(value: object) -> None:
    with pytest.raises(
        ConfigurationError, match=r"^it is .*; it must be a finite number$"
    ) as error:
        number_of(value, "it")
    assert len(str(error.value)) < 150


@pytest.mark.parametrize("value", [0, -3, 1.5, sys.float_info.max, 10**300])
def test_finite_numbers_are_taken(value: float) -> None:
    assert number_of(value, "it") == float(value)
