"""Presets of the point maze."""

from __future__ import annotations

from dataclasses import replace

from skewmi.batch_env import Condition, Event, GridAxis, TaskMetrics
from skewmi.train.config import TrainConfig
from skewmi.train.exploration.skew_explore import SkewExploreConfig
from skewmi.train.presets.shared import PAPER_EXPLORATION, PAPER_ROLLOUT, PAPER_SAC
from skewmi.train.sac.config import SacConfig

_TASK = "point_maze"
_METRICS = TaskMetrics(
    grid=(GridAxis("x", -12.0, 4.0, 50), GridAxis("y", -6.0, 6.0, 50)),
    events=(
        Event("left half", (Condition("x", high=-5.0),)),
        Event("left corridor", (Condition("x", high=-7.0), Condition("y", -2.0, 2.0))),
    ),
)
PRESETS = (
    TrainConfig(
        task=_TASK,
        preset="paper",
        task_options=(("time_input", True),),
        task_metrics=_METRICS,
        total_steps=1_000_000,
        learner=PAPER_SAC,
        exploration=replace(
            PAPER_EXPLORATION,
            intrinsic=0.01,
            sigma=2.0,
            trajectory_bandwidth=0.5,
            goal_clip=None,
            trajectory_clip=None,
            running_scale=False,
        ),
        rollout=PAPER_ROLLOUT,
    ),
    TrainConfig(
        task=_TASK,
        preset="improved",
        task_options=(("time_input", True),),
        task_metrics=_METRICS,
        total_steps=500_000,
        learner=SacConfig(
            updates_per_step=0.14,
            rare_fraction=0.0,  # not tried here
        ),
        exploration=SkewExploreConfig(
            intrinsic=0.01,
            sigma=2.0,
            trajectory_bandwidth=0.5,
            goal_clip=None,
            trajectory_clip=None,
            running_scale=False,
            history_bandwidth=0.3,
            weight_exponent=-2.5,
        ),
    ),
)
