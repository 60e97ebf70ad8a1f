"""Presets of opening the door to a given angle."""

from __future__ import annotations

from dataclasses import replace

from skewmi.train.config import MetricsConfig, TrainConfig
from skewmi.train.exploration.skew_explore import SkewExploreConfig
from skewmi.train.presets import methods
from skewmi.train.presets.shared import PAPER_EXPLORATION, PAPER_ROLLOUT, PAPER_SAC, reduced
from skewmi.train.sac.config import SacConfig

_TASK = "door_open"
_PAPER = TrainConfig(
    task=_TASK,
    preset="paper",
    # The published grid has an axis for the fingers, which only an action of theirs moves.
    task_options=(("gripper_action", True), ("time_input", True)),
    total_steps=1_000_000,
    learner=PAPER_SAC,
    exploration=replace(PAPER_EXPLORATION, trajectory_bandwidth=0.05),
    rollout=PAPER_ROLLOUT,
    metrics=MetricsConfig(every_steps=25_000),
)
_SAC = SacConfig(target_entropy=-1.5)
_IMPROVED = TrainConfig(
    task=_TASK,
    preset="improved",
    task_options=(("time_input", True),),
    total_steps=1_000_000,
    learner=_SAC,
    # What goals should differ in is the door; the fingers are not commanded.
    exploration=SkewExploreConfig(field_weights=(("door_angle", 2.5), ("gripper", 0.1))),
    # A fifth of the points: the grid has 20,000.
    metrics=MetricsConfig(every_steps=25_000, entropy_points=10_000),
)
_REDUCED = reduced(_PAPER)
PRESETS = (
    _PAPER,
    _IMPROVED,
    *methods.PAPER.presets(_PAPER),
    *methods.IMPROVED.presets(_IMPROVED),
    # Target t2 of one seed was learned after 100 trajectories, with half the rate after 225.
    methods.return_then_explore(
        replace(_IMPROVED, learner=replace(_SAC, learning_rate=1e-3)),
        updates_per_step=0.4,
        arrival_radius=0.5,
        stall_distance=0.2,
    ),
    _REDUCED,
    *methods.PAPER.presets(_REDUCED),
)
