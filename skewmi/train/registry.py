"""The learners and explorations there are, by name: one line for each.

A new one is a folder or file that satisfies `learner.Learner` or `exploration.protocol
.Exploration`, a configuration derived from `LearnerConfig` or `ExplorationConfig`, and its line
here. Command line, checkpoints and runner need to know nothing else about it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import nn

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.exploration.protocol import Exploration, ExplorationConfig
from skewmi.train.exploration.return_then_explore import (
    ReturnThenExplore,
    ReturnThenExploreConfig,
)
from skewmi.train.exploration.rnd import Rnd, RndConfig
from skewmi.train.exploration.skew_explore import SkewExplore, SkewExploreConfig
from skewmi.train.exploration.skew_fit import SkewFit, SkewFitConfig
from skewmi.train.learner import Learner, LearnerConfig
from skewmi.train.ppo import module as ppo_module
from skewmi.train.ppo.config import PpoConfig
from skewmi.train.ppo.learner import PpoLearner
from skewmi.train.sac import module as sac_module
from skewmi.train.sac.config import SacConfig
from skewmi.train.sac.learner import SacLearner
from skewmi.train.state import State


@dataclass(frozen=True)
class Entry:
    """One method.

    Attributes:
        config: Type of its numbers; all have defaults.
        make: Builds it. A learner from (config, layout, goal_dim, seed, device), an exploration
            from (config, layout, generator).
        policy: Of a learner: the policy in a checkpoint, from (config, layout, goal, state), for
            who has not what learning needs; None: the whole learner is made for it.
    """

    config: type[Any]
    make: Callable[..., Any]
    policy: Callable[..., nn.Module] | None = None


LEARNERS: dict[str, Entry] = {
    "sac": Entry(SacConfig, SacLearner, sac_module.policy_of),
    "ppo": Entry(PpoConfig, PpoLearner, ppo_module.policy_of),
}
EXPLORATIONS: dict[str, Entry] = {
    "skew-explore": Entry(SkewExploreConfig, SkewExplore),
    "return-then-explore": Entry(ReturnThenExploreConfig, ReturnThenExplore),
    "skew-fit": Entry(SkewFitConfig, SkewFit),
    "rnd": Entry(RndConfig, Rnd),
}


def entry_of(config: LearnerConfig | ExplorationConfig) -> tuple[str, Entry]:
    """Name and entry of the method that some numbers belong to.

    Raises:
        ConfigurationError: It is not registered.
    """
    entries = LEARNERS if isinstance(config, LearnerConfig) else EXPLORATIONS
    for name, entry in entries.items():
        if type(config) is entry.config:
            return name, entry
    raise ConfigurationError(
        f"{type(config).__name__} belongs to no registered method; there are {', '.join(entries)}"
    )


def default_config(entries: Mapping[str, Entry], name: str) -> Any:
    """The numbers of a method as it brings them.

    Args:
        entries: `LEARNERS` or `EXPLORATIONS`.
        name: Of one of them.

    Raises:
        NotFoundError: There is no such method.
    """
    if name not in entries:
        kind = "learner" if entries is LEARNERS else "exploration"
        raise NotFoundError(f"no {kind} {name!r}; there are {', '.join(entries)}")
    return entries[name].config()


def make_learner(
    config: LearnerConfig, layout: PolicyLayout, goal_dim: int, seed: int, device: str
) -> Learner:
    """The learner that some numbers belong to.

    Args:
        config: Its numbers.
        layout: Of the task.
        goal_dim: Size of the exploration's goals, 0 if it has none.
        seed: Of its networks and its own random stream.
        device: `cpu` or `cuda`.
    """
    learner: Learner = entry_of(config)[1].make(config, layout, goal_dim, seed, device)
    return learner


def make_policy(
    config: LearnerConfig, layout: PolicyLayout, goal: Array, state: State
) -> nn.Module:
    """The deterministic policy of a learner towards one goal, on the CPU.

    Args:
        config: The learner's numbers.
        layout: Of the task.
        goal: In the task's units. Shape (goal_dim,).
        state: Of the learner, wherever it has learned.

    Raises:
        CheckpointError, KeyError, ValueError, TypeError: The state does not fit or is damaged.
    """
    make = entry_of(config)[1].policy
    if make is not None:
        return make(config, layout, goal, state)
    learner = make_learner(config, layout, len(goal), 0, "cpu")
    learner.load_state_dict(state)
    return learner.policy_module(goal)


def make_exploration(
    config: ExplorationConfig, layout: PolicyLayout, generator: np.random.Generator
) -> Exploration:
    """The exploration that some numbers belong to.

    Args:
        config: Its numbers.
        layout: Of the task.
        generator: Of the random choices that it begins with.
    """
    exploration: Exploration = entry_of(config)[1].make(config, layout, generator)
    return exploration
