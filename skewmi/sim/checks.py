"""Refusals that every task makes in the same words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.policy_io import Array
from skewmi.yaml_text import shown

_T = TypeVar("_T")


def checked_num_envs(num_envs: int) -> int:
    """The number itself.

    Raises:
        ConfigurationError: It is not a whole number from 1.
    """
    if isinstance(num_envs, bool) or int(num_envs) != num_envs or num_envs < 1:
        raise ConfigurationError(f"num_envs is {num_envs!r}; it must be a whole number from 1")
    return int(num_envs)


def checked_num_threads(num_threads: int) -> int:
    """The number itself; 0 leaves the choice to the task.

    Raises:
        ConfigurationError: It is not a whole number from 0.
    """
    if isinstance(num_threads, bool) or int(num_threads) != num_threads or num_threads < 0:
        raise ConfigurationError(
            f"num_threads is {num_threads!r}; it must be a whole number from 0 (automatic)"
        )
    return int(num_threads)


def checked_switches(**given: object) -> dict[str, bool]:
    """The values themselves.

    Raises:
        ConfigurationError: One is neither true nor false; the message names it.
    """
    for name, value in given.items():
        if not isinstance(value, bool | np.bool_):
            raise ConfigurationError(f"{name} is {shown(value)}; it must be true or false")
    return {name: bool(value) for name, value in given.items()}


def checked_width(value: object, name: str, end: float, unit: str) -> float:
    """The number itself.

    Raises:
        ConfigurationError: It is no number, or not in [0, end).
    """
    number = isinstance(value, int | float | np.integer | np.floating)
    if isinstance(value, bool) or not number or not 0.0 <= value < end:  # type: ignore[operator]
        raise ConfigurationError(
            f"{name} is {shown(value)}; it must be a number from 0 to less than {end:g} {unit}"
        )
    return float(value)  # type: ignore[arg-type]


def checked_action(action: ArrayLike, num_envs: int, action_dim: int) -> Array:
    """The action as float64. Shape (num_envs, action_dim).

    Raises:
        ConfigurationError: It has another shape, or is not finite.
    """
    try:
        values = np.asarray(action, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"action is not an array of numbers: {error}") from error
    if values.shape != (num_envs, action_dim):
        raise ConfigurationError(
            f"action has shape {values.shape}; this environment takes "
            f"(num_envs, action_dim) = {(num_envs, action_dim)}"
        )
    if not np.isfinite(values).all():
        row, column = np.argwhere(~np.isfinite(values))[0]
        raise ConfigurationError(
            f"action[{row}, {column}] is {values[row, column]}; actions must be finite, in -1..1"
        )
    return values


def chosen_target(task: str, targets: Mapping[str, _T], name: str) -> _T:
    """One of a task's targets.

    Args:
        task: Name of the task.
        targets: What it has, by name.
        name: Which.

    Raises:
        NotFoundError: There is no such target; the message lists those that exist.
    """
    if not isinstance(name, str) or name not in targets:
        there_are = (
            f"targets are {', '.join(targets)}" if targets else "it has one alone: leave it out"
        )
        raise NotFoundError(f"task {task!r} has no target {name!r}; {there_are}")
    return targets[name]
