"""The tasks by name.

Each task is a module, imported when first asked for, that has `make_batch(num_envs, *,
num_threads, seed, **options)` and `layout(**options)`.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from typing import Any, TypeVar

from skewmi.batch_env import BatchEnv
from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.policy_io import PolicyLayout

_MODULES = {
    "open_press_close": "skewmi.sim.arm.batch",
    "point_maze": "skewmi.sim.tasks.point_maze.task",
}

TASKS = tuple(_MODULES)

_T = TypeVar("_T")


def make_batch(
    name: str, num_envs: int, *, num_threads: int = 0, seed: int = 0, **options: Any
) -> BatchEnv:
    """Make `num_envs` copies of a task.

    Args:
        name: One of `TASKS`.
        num_envs: How many copies.
        num_threads: Threads that step them; 0 chooses.
        seed: Of everything random.
        options: What the task itself takes.

    Raises:
        NotFoundError: There is no such task; the message lists those that exist.
        ConfigurationError: There is no such option, or a value is not allowed.
    """
    make: Callable[..., BatchEnv] = _task_function(name, "make_batch")
    return _call(name, make, num_envs, num_threads=num_threads, seed=seed, **options)


def layout(name: str, **options: Any) -> PolicyLayout:
    """Observation and action of a task; options as in `make_batch`.

    Raises:
        NotFoundError: There is no such task.
        ConfigurationError: The layout does not depend on such an option.
    """
    make: Callable[..., PolicyLayout] = _task_function(name, "layout")
    return _call(name, make, **options)


def _task_function(name: str, function: str) -> Callable[..., Any]:
    if name not in _MODULES:
        raise NotFoundError(f"no task {name!r}; tasks are {', '.join(TASKS)}")
    found: Callable[..., Any] = getattr(importlib.import_module(_MODULES[name]), function)
    return found


def _call(name: str, function: Callable[..., _T], *args: Any, **options: Any) -> _T:
    try:
        inspect.signature(function).bind(*args, **options)
    except TypeError as error:
        known = [p for p in inspect.signature(function).parameters if p != "num_envs"]
        raise ConfigurationError(
            f"task {name!r}: {error}; options are {', '.join(known)}"
        ) from error
    return function(*args, **options)
