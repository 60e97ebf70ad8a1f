"""Presets of the point maze."""

from __future__ import annotations

from dataclasses import replace

from skewmi.train.config import TrainConfig
from skewmi.train.exploration.skew_explore import SkewExploreConfig
from skewmi.train.presets import methods
from skewmi.train.presets.shared import PAPER_EXPLORATION, PAPER_ROLLOUT, PAPER_SAC, reduced
from skewmi.train.sac.config import SacConfig

_TASK = "point_maze"
_PAPER = TrainConfig(
    task=_TASK,
    preset="paper",
    task_options=(("time_input", True),),
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
)
_SAC = SacConfig(
    updates_per_step=0.14,
    rare_fraction=0.0,  # not tried here
)
_IMPROVED = TrainConfig(
    task=_TASK,
    preset="improved",
    task_options=(("time_input", True),),
    total_steps=500_000,
    learner=_SAC,
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
)
_REDUCED = reduced(_PAPER)
PRESETS = (
    _PAPER,
    _IMPROVED,
    *methods.PAPER.presets(_PAPER),
    *methods.IMPROVED.presets(_IMPROVED),
    # Entropy at refresh 16, of one seed each: 48.4 with 0.2 updates a step at 5e-4, 48.6 at 1e-3,
    # 51.6 and 52.1 with 0.4. How well goals are reached decides.
    methods.return_then_explore(
        replace(_IMPROVED, learner=replace(_SAC, learning_rate=1e-3)),
        updates_per_step=0.4,
        arrival_radius=0.7,
        stall_distance=0.3,
    ),
    _REDUCED,
    *methods.PAPER.presets(_REDUCED),
)
