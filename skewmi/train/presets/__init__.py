"""Starting points: two per task, `paper` (faithful) and `improved` (ours, the default).

This is the only module of `train` that knows tasks by name.
"""

from __future__ import annotations

from dataclasses import replace

from skewmi.errors import NotFoundError
from skewmi.train.config import (
    Condition,
    Event,
    GridAxis,
    MetricsConfig,
    ReplayConfig,
    RolloutConfig,
    SacConfig,
    SkewConfig,
    TrainConfig,
)

PRESETS = ("paper", "improved")

# ---- what the publication and its code share between tasks -----------------------------------
_PAPER_SAC = SacConfig(
    hidden=(32, 64, 128, 64, 32),
    layer_norm=False,
    normalize_input=False,
    learning_rate=1e-3,
    discount=0.98,
    batch_size=1024,
    n_step=1,
    initial_temperature=1.0,
    log_std_min=-20.0,
    updates_per_step=1.0,
)
# The code stores each transition once as it was, 10 times with future goals and 4 times with
# proposals.
_PAPER_REPLAY = ReplayConfig(
    capacity_steps=1_000_000,
    future_fraction=10 / 15,
    proposal_fraction=4 / 15,
    rewarded_fraction=0.0,
    rare_fraction=0.0,
)
_PAPER_SKEW = SkewConfig(
    intrinsic=0.005,
    # 10 x Gaussian of width 0.5: between 10.3 and 11.3 within the reward region.
    extrinsic=11.0,
    sigma=1.5,
    scale_floor=0.0,
    history_points=50_000,
    history_bandwidth=0.1,
    candidates=10_000,
    candidates_from="density",
    self_count=0.0,
    weight_exponent=-1.1,
)
_PAPER_ROLLOUT = RolloutConfig(
    num_envs=1,
    random_steps=200,
    switch_probability=0.0,
    noise_probability=0.0,
    rewarded_goal_max=0.0,
    evaluation_envs=0,
)

# ---- point maze ------------------------------------------------------------------------------
_MAZE_METRICS = MetricsConfig(
    grid=(GridAxis("x", -12.0, 4.0, 50), GridAxis("y", -6.0, 6.0, 50)),
    every_steps=5_000,
    events=(
        Event("left half", (Condition("x", high=-5.0),)),
        Event("left corridor", (Condition("x", high=-7.0), Condition("y", -2.0, 2.0))),
    ),
)
_MAZE_PAPER = TrainConfig(
    task="point_maze",
    preset="paper",
    task_options=(("time_input", True),),
    total_steps=1_000_000,
    sac=_PAPER_SAC,
    replay=_PAPER_REPLAY,
    skew=replace(
        _PAPER_SKEW,
        intrinsic=0.01,
        sigma=2.0,
        trajectory_bandwidth=0.5,
        goal_clip=None,
        trajectory_clip=None,
        running_scale=False,
    ),
    rollout=_PAPER_ROLLOUT,
    metrics=_MAZE_METRICS,
)
_MAZE_IMPROVED = TrainConfig(
    task="point_maze",
    preset="improved",
    task_options=(("time_input", True),),
    total_steps=500_000,
    sac=SacConfig(updates_per_step=0.14),
    replay=ReplayConfig(rare_fraction=0.0),  # not tried here
    skew=SkewConfig(
        intrinsic=0.01,
        sigma=2.0,
        trajectory_bandwidth=0.5,
        goal_clip=None,
        trajectory_clip=None,
        running_scale=False,
        history_bandwidth=0.3,
        weight_exponent=-2.5,
    ),
    metrics=_MAZE_METRICS,
)

# ---- open, press, close ----------------------------------------------------------------------
_LID, _BUTTON = "lid_angle", "button_depth"
_PRESS_METRICS = MetricsConfig(
    # The code's grid for this task has one point per hand and gripper axis; its metrics are
    # about lid and button.
    grid=(GridAxis(_LID, 0.0, 2.5, 10), GridAxis(_BUTTON, 0.0, 0.03, 5)),
    unit_range=True,
    every_steps=25_000,
    events=(
        Event("lid above 30 degrees", (Condition(_LID, low=0.5236),)),
        Event("lid above 90 degrees", (Condition(_LID, low=1.5708),)),
        Event("button pressed", (Condition(_BUTTON, low=0.010),)),
        Event(
            "lid below 15 degrees after pressing",
            (Condition(_BUTTON, low=0.010), Condition(_LID, high=0.2618)),
        ),
    ),
)
_PRESS_PAPER = TrainConfig(
    task="open_press_close",
    preset="paper",
    task_options=(("gripper_action", True), ("time_input", True)),
    total_steps=5_000_000,
    sac=_PAPER_SAC,
    replay=replace(_PAPER_REPLAY, capacity_steps=5_000_000),
    skew=replace(_PAPER_SKEW, trajectory_bandwidth=0.2, history_bandwidth=0.11),
    rollout=_PAPER_ROLLOUT,
    metrics=_PRESS_METRICS,
)
_PRESS_IMPROVED = TrainConfig(
    task="open_press_close",
    preset="improved",
    task_options=(("time_input", True),),
    total_steps=2_000_000,
    sac=SacConfig(target_entropy=-1.5),
    # What goals should differ in is the lid; x spans 20 mm of the hand's box, and the fingers are
    # not commanded: where contact bends them is not worth a goal.
    skew=SkewConfig(field_weights=((_LID, 2.5), (_BUTTON, 1.0), ("gripper", 0.1), ("hand_x", 0.3))),
    rollout=RolloutConfig(),
    metrics=_PRESS_METRICS,
)

_ALL = {(c.task, c.preset): c for c in (_MAZE_PAPER, _MAZE_IMPROVED, _PRESS_PAPER, _PRESS_IMPROVED)}


def preset(task: str, name: str = "improved") -> TrainConfig:
    """The configuration to start from.

    Raises:
        NotFoundError: There is none for this task and name; the message lists those there are.
    """
    try:
        return _ALL[task, name]
    except KeyError:
        known = ", ".join(f"{t}/{n}" for t, n in _ALL)
        raise NotFoundError(f"no preset {task}/{name}; presets are {known}") from None
