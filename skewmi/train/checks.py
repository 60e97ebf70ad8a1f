"""Refusing values that a configuration must not have."""

from __future__ import annotations

from skewmi.errors import ConfigurationError


def require(condition: bool, message: str) -> None:
    """Go on only if a condition holds.

    Raises:
        ConfigurationError: It does not; with the message.
    """
    if not condition:
        raise ConfigurationError(message)
