"""Numbers that commands take: checked before anything else happens, with one message for all."""

from __future__ import annotations

import math

from skewmi.errors import ConfigurationError
from skewmi.sim.tasks.registry import MAX_SEED

MAX_EPISODES = 1_000_000
MAX_ENVS = 100_000
MAX_THREADS = 4096


def require(option: str, value: float | None, low: float, high: float) -> None:
    """Raise unless a number is in a range, bounds included; None stands for "not given".

    Raises:
        ConfigurationError: It is not; the message names the option, the value and the range.
    """
    if value is not None and not low <= value <= high:
        raise ConfigurationError(f"{option} is {value}; it must be in {low:g}..{high:g}")


def require_seed(value: int) -> None:
    """Raise unless a number is a seed that every random generator takes.

    Raises:
        ConfigurationError: It is not.
    """
    if not 0 <= value <= MAX_SEED:
        raise ConfigurationError(f"--seed is {value}; it must be in 0..{MAX_SEED}")


def require_positive(option: str, value: float | None) -> None:
    """Raise unless a number is above 0 and finite; None stands for "not given".

    Raises:
        ConfigurationError: It is not.
    """
    if value is not None and not 0.0 < value < math.inf:
        raise ConfigurationError(f"{option} is {value}; it must be positive and finite")
