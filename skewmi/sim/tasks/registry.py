"""Where tasks are found by name; a task's module is imported when it is first asked for."""

from __future__ import annotations

import functools
import importlib
import inspect
from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any, TypeVar

from skewmi.batch_env import BatchEnv
from skewmi.errors import ConfigurationError, NotFoundError, did_you_mean
from skewmi.policy_io import PolicyLayout
from skewmi.sim.task_spec import TaskSpec

GROUP = "skewmi.tasks"
"""Entry points by which other packages register tasks: `name = "package.module:SPEC"`."""

MAX_SEED = 2**63 - 1
"""What every generator here takes: numpy's any natural number, torch's 64 bits."""

_registered: dict[str, str] = {}

_T = TypeVar("_T")


def register(name: str, where: str) -> None:
    """Register a task.

    Args:
        name: Of the task.
        where: Of its `TaskSpec`, `package.module:ATTRIBUTE`; imported when it is asked for.

    Raises:
        ConfigurationError: There is another task of that name, or the name is not one that files
            and flags take.
    """
    if not (name.isidentifier() and name == name.lower()):
        raise ConfigurationError(
            f"task name {name!r} must be small letters, digits and underscores, as open_drawer"
        )
    if _registered.setdefault(name, where) != where:
        raise ConfigurationError(
            f"2 tasks are called {name!r}: {_registered[name]} and {where}; rename one"
        )
    find.cache_clear()


@functools.cache
def _of_other_packages() -> dict[str, tuple[str, ...]]:
    """Where other packages say that tasks are, by name: one place, unless two packages clash."""
    found: dict[str, tuple[str, ...]] = {}
    for point in entry_points(group=GROUP):
        # One package may be found twice, as where it was edited and where it is installed.
        places = found.get(point.name, ())
        found[point.name] = places if point.value in places else (*places, point.value)
    return found


def names() -> tuple[str, ...]:
    """Every task: our own first, then those of other packages by name."""
    return (*_registered, *sorted(_of_other_packages().keys() - _registered.keys()))


def default() -> str:
    """The task of commands that are not told which: the first one registered."""
    return names()[0]


@functools.cache
def find(name: str) -> TaskSpec:
    """A task by its name.

    Raises:
        NotFoundError: There is no such task; the message lists those that exist.
        ConfigurationError: Its package cannot be imported, or is no task's.
    """
    ours = (_registered[name],) if name in _registered else ()
    places = tuple(dict.fromkeys((*ours, *_of_other_packages().get(name, ()))))
    if not places:
        raise NotFoundError(
            f"no task {name!r}; tasks are {', '.join(names())}{did_you_mean(name, names())}"
        )
    if len(places) > 1:
        raise ConfigurationError(
            f"{len(places)} tasks are called {name!r}: {', '.join(places)}; uninstall the packages "
            "of all but one, or rename their tasks"
        )
    where = places[0]
    module, _, attribute = where.partition(":")
    try:
        spec = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise ConfigurationError(f"task {name!r} cannot be loaded from {where}: {error}") from error
    if not isinstance(spec, TaskSpec) or spec.name != name:
        found = spec.name if isinstance(spec, TaskSpec) else f"a {type(spec).__name__}"
        raise ConfigurationError(f"{where} is registered as task {name!r}, but is {found!r}")
    return spec


def with_arm() -> tuple[str, ...]:
    """The tasks that have a robot; imports all of them."""
    return tuple(name for name in names() if find(name).arm is not None)


def make_batch(
    name: str, num_envs: int, *, num_threads: int = 0, seed: int = 0, **options: Any
) -> BatchEnv:
    """Make `num_envs` copies of a task.

    Args:
        name: One of `names()`.
        num_envs: How many copies.
        num_threads: Threads that step them; 0 chooses.
        seed: Of everything random.
        options: What the task itself takes.

    Raises:
        NotFoundError: There is no such task; the message lists those that exist.
        ConfigurationError: There is no such option, or a value is not allowed.
    """
    if not 0 <= seed <= MAX_SEED:
        raise ConfigurationError(f"seed is {seed}; it must be in 0..{MAX_SEED}")
    return _call(name, find(name).batch, num_envs, num_threads=num_threads, seed=seed, **options)


def layout(name: str, **options: Any) -> PolicyLayout:
    """Observation and action of a task.

    Args:
        name: One of `names()`.
        options: Its `layout_switches`.

    Raises:
        NotFoundError: There is no such task.
        ConfigurationError: The layout does not depend on such an option.
    """
    return _call(name, find(name).layout, **options)


def _call(name: str, function: Callable[..., _T], *args: Any, **options: Any) -> _T:
    signature = inspect.signature(function)
    try:
        signature.bind(*args, **options)
    except TypeError as error:
        known = [p for p in signature.parameters if p != "num_envs"]
        raise ConfigurationError(
            f"task {name!r}: {error}; options are {', '.join(known)}"
        ) from error
    return function(*args, **options)
