"""Values of a calibration file, checked one by one; messages begin with where the value stands."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

from skewmi.errors import ConfigurationError
from skewmi.yaml_text import shown


def mapping_of(value: object, where: str) -> Mapping[str, object]:
    """A mapping whose keys are texts."""
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ConfigurationError(f"{where} is {shown(value)}; it must map names to values")
    return value


def checked_keys(
    entries: Mapping[str, object],
    where: str,
    required: Sequence[str],
    optional: Sequence[str] = (),
) -> None:
    """Every required key and no unknown one.

    Raises:
        ConfigurationError: The message lists what is allowed.
    """
    allowed = (*required, *optional)
    for key in entries:
        if key not in allowed:
            raise ConfigurationError(
                f"{where} has an unknown key {shown(key)}; allowed: {', '.join(allowed)}"
            )
    for key in required:
        if key not in entries:
            raise ConfigurationError(f"{where} lacks the key {key!r}")


def sequence_of(value: object, where: str, length: int | None = None) -> list[object]:
    """A list, of that length."""
    if not isinstance(value, list | tuple) or (length is not None and len(value) != length):
        size = "" if length is None else f" of {length}"
        raise ConfigurationError(f"{where} is {shown(value)}; it must be a list{size}")
    return list(value)


def number_of(value: object, where: str) -> float:
    """A finite number."""
    # Compared, since math.isfinite fails on a whole number that no float can hold.
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not abs(value) <= sys.float_info.max
    ):
        raise ConfigurationError(f"{where} is {shown(value)}; it must be a finite number")
    return float(value)


def flag_of(value: object, where: str) -> bool:
    """true or false."""
    if not isinstance(value, bool):
        raise ConfigurationError(f"{where} is {shown(value)}; it must be true or false")
    return value


def text_of(value: object, where: str) -> str:
    """A text that is not empty."""
    if not isinstance(value, str) or not value.strip():
        raise ConfigurationError(
            f"{where} is {shown(value)}; it must be a text (in quotes, if it looks like a number "
            "or a date)"
        )
    return value
