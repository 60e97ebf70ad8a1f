"""What the publication and its code share between tasks; `docs/paper.md` lists the sources."""

from __future__ import annotations

from dataclasses import replace

from skewmi.train.config import RolloutConfig, TrainConfig
from skewmi.train.exploration.skew_explore import SkewExploreConfig
from skewmi.train.sac.config import SacConfig

PAPER_SAC = SacConfig(
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
    # The code stores each transition once as it was, 10 times with future goals and 4 times with
    # proposals.
    future_fraction=10 / 15,
    proposal_fraction=4 / 15,
    rewarded_fraction=0.0,
    rare_fraction=0.0,
)
PAPER_EXPLORATION = SkewExploreConfig(
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
    switch_probability=0.0,
    rewarded_goal_max=0.0,
)
PAPER_ROLLOUT = RolloutConfig(
    num_envs=1,
    evaluation_envs=0,
    random_steps=200,
    noise_probability=0.0,
    history_steps=1_000_000,
)
REDUCED_BATCH_SIZE = 128
"""An eighth of the publication's gradient samples: as many updates, of smaller batches. The other
way to save, the same batch every ten steps, explores the maze far slower: docs/sweep.md."""
REDUCED_ENVS = 5
"""Episodes between two rounds of updates, instead of one: stepping them together saves time."""


def reduced(paper: TrainConfig) -> TrainConfig:
    """The publication's preset at an eighth of its gradient samples; all other constants stay.

    PPO's presets learn from each step 15 times where SAC's draw 1,024 samples per step, so there
    is nothing to reduce in them: `paper-reduced-ppo` and its kin are the `paper` ones.
    """
    assert isinstance(paper.learner, SacConfig)
    return replace(
        paper,
        preset=f"{paper.preset}-reduced",
        learner=replace(paper.learner, batch_size=REDUCED_BATCH_SIZE),
        rollout=replace(paper.rollout, num_envs=REDUCED_ENVS),
    )
