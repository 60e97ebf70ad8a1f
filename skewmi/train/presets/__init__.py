"""Starting points of runs, by task and name.

`paper` is faithful to the publication, `improved` is ours and the default. Each task's are in a
file of their own, which is the only place in `train` that may name it; a task without any of its
own starts from the defaults of every number.
"""

from __future__ import annotations

from skewmi.errors import NotFoundError
from skewmi.train.config import TrainConfig
from skewmi.train.presets import open_press_close, point_maze
from skewmi.train.registry import EXPLORATIONS, LEARNERS, default_config

DEFAULT = "improved"
"""Preset of those who name none, and name of the defaults of every number."""

PRESETS: dict[tuple[str, str], TrainConfig] = {
    (config.task, config.preset): config
    for config in (
        *point_maze.PRESETS,
        *open_press_close.PRESETS,
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


def names(task: str) -> tuple[str, ...]:
    """Names of a task's presets."""
    return tuple(name for t, name in PRESETS if t == task) or (DEFAULT,)


def preset(task: str, name: str = DEFAULT) -> TrainConfig:
    """The configuration to start from.

    Raises:
        NotFoundError: The task has presets, but none of this name; the message lists them.
    """
    known = names(task)
    if name not in known:
        raise NotFoundError(
            f"no preset {name!r} for task {task!r}; presets are "
            + ", ".join(f"{task}/{known_name}" for known_name in known)
        )
    return PRESETS.get((task, name)) or default_preset(task)
