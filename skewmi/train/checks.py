"""Refusing values that a configuration must not have."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from skewmi.errors import ConfigurationError


def require(condition: bool, message: str) -> None:
    """Go on only if a condition holds.

    Raises:
        ConfigurationError: It does not; with the message.
    """
    if not condition:
        raise ConfigurationError(message)


def require_finite(config: Any) -> None:
    """Go on only if no number of a dataclass is infinite or not a number, tuples included.

    Raises:
        ConfigurationError: One is; it is named.
    """
    for field in fields(config):
        value = getattr(config, field.name)
        require(
            all(math.isfinite(number) for number in _floats(value)),
            f"{field.name} is {value}, must be finite",
        )


def _floats(value: Any) -> Iterator[float]:
    if isinstance(value, float):
        yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from _floats(part)


def require_at_least(least: float, config: Any, *names: str) -> None:
    """Go on only if numbers of a configuration, those that are given, are not below a bound.

    Args:
        least: The bound.
        config: Has the numbers; None is one that is not given.
        names: Of the numbers.

    Raises:
        ConfigurationError: One is below; it is named.
    """
    for name in names:
        value = getattr(config, name)
        require(value is None or value >= least, f"{name} is {value}, needs at least {least}")


def require_positive(config: Any, *names: str) -> None:
    """As `require_at_least`, for numbers that must be above 0."""
    for name in names:
        value = getattr(config, name)
        require(value is None or value > 0, f"{name} is {value}, must be positive")


def require_between(low: float, high: float, config: Any, *names: str) -> None:
    """As `require_at_least`, for numbers that must lie in [low, high]."""
    for name in names:
        value = getattr(config, name)
        require(
            value is None or low <= value <= high,
            f"{name} is {value}, must lie in [{low:g}, {high:g}]",
        )
