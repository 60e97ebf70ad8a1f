"""What the numbers of a run are called: each has one name, however a file writes it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from skewmi.errors import ConfigurationError

_OTHERS = {"steps": "total_steps"}
"""What the command line calls them -> their names."""
_T = TypeVar("_T")


def by_one_name(numbers: Mapping[str, _T], where: str) -> dict[str, _T]:
    """Numbers by name, so that those of a narrower place replace a wider one's.

    Args:
        numbers: As one `set` of a file writes them: with dashes or underscores, and `steps` or
            `total_steps`.
        where: The `set`, for messages.

    Raises:
        ConfigurationError: One is there twice, and which of the values counts is nowhere said.
    """
    written: dict[str, str] = {}
    for key in numbers:
        name = key.replace("-", "_")
        name = _OTHERS.get(name, name)
        if name in written:
            raise ConfigurationError(
                f"{where}: {name} is given twice, as {written[name]!r} and {key!r}; give it once"
            )
        written[name] = key
    return {name: numbers[key] for name, key in written.items()}
