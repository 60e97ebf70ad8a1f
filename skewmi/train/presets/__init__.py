"""Starting points of runs, by task and name.

`paper` is faithful to the publication, `paper-reduced` the same with an eighth of its gradient
samples, `improved` the same method with our numbers, `improved-return-then-explore` the quickest
and where a task has it the default; `paper-ppo`, `paper-skew-fit` and the like are the other
methods of its comparison (`methods.py`). Each task's are in a file of their own, which is the only
place in `train` that may name it; a task without any starts from the defaults of every number. What
is measured in a task it says itself: it is not here.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping

from skewmi.errors import ConfigurationError, NotFoundError, did_you_mean
from skewmi.train.config import TrainConfig
from skewmi.train.presets import door_open, open_press_close, point_maze
from skewmi.train.registry import EXPLORATIONS, LEARNERS, default_config

DEFAULT = "improved"
"""Preset of those who combine a learner and an exploration of their own, and name of the defaults
of every number."""

QUICKEST = "improved-return-then-explore"
"""Preset of those who name nothing, where a task has it; docs/return-then-explore.md has its
results. PPO, which must not learn from random actions, cannot take it."""

PRESETS: dict[tuple[str, str], TrainConfig] = {
    (config.task, config.preset): config
    for config in (
        *point_maze.PRESETS,
        *open_press_close.PRESETS,
        *door_open.PRESETS,
    )
}
"""By task and name."""


def default_preset(task: str) -> TrainConfig:
    """The defaults of every number, with the first learner and exploration registered."""
    return TrainConfig(
        learner=default_config(LEARNERS, next(iter(LEARNERS))),
        exploration=default_config(EXPLORATIONS, next(iter(EXPLORATIONS))),
        task=task,
        preset=DEFAULT,
    )


def names(task: str, elsewhere: Mapping[str, str] | None = None) -> tuple[str, ...]:
    """Names of a task's presets, see `preset`."""
    own = [name for t, name in PRESETS if t == task]
    return tuple(dict.fromkeys((*own, *(elsewhere or ())))) or (DEFAULT,)


def recommended(task: str, elsewhere: Mapping[str, str] | None = None) -> str:
    """Name of the preset of those who name neither preset, learner nor exploration.

    Args:
        task: Name of the task.
        elsewhere: See `preset`.
    """
    return QUICKEST if QUICKEST in names(task, elsewhere) else DEFAULT


def preset(
    task: str, name: str = DEFAULT, elsewhere: Mapping[str, str] | None = None
) -> TrainConfig:
    """The configuration to start from.

    Args:
        task: Name of the task.
        name: Of the preset.
        elsewhere: Where the task has presets beside those of this package: by name
            `package.module:ATTRIBUTE`, a `TrainConfig`.

    Raises:
        NotFoundError: The task has presets, but none of this name; the message lists them.
        ConfigurationError: There is no configuration where the task says that it has one.
    """
    if (task, name) in PRESETS:
        return PRESETS[task, name]
    known = names(task, elsewhere)
    if name not in known:
        raise NotFoundError(
            f"no preset {name!r} for task {task!r}; presets are "
            + ", ".join(f"{task}/{known_name}" for known_name in known)
            + did_you_mean(name, known)
        )
    return _load(task, elsewhere[name]) if elsewhere else default_preset(task)


def _load(task: str, where: str) -> TrainConfig:
    module, _, attribute = where.partition(":")
    try:
        config = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise ConfigurationError(f"preset of task {task!r} at {where}: {error}") from error
    if not isinstance(config, TrainConfig) or config.task != task:
        raise ConfigurationError(f"{where} is no training configuration of task {task!r}")
    return config
