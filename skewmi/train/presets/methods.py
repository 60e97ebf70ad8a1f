"""The other methods of the publication's comparison, from a preset of Skew-Explore on SAC.

Learner and exploration change, the rest of the preset stays. A preset NAME gives

    NAME-return-then-explore    SAC with return-then-explore (not of that comparison; `improved`)
    NAME-ppo            PPO + LSTM with Skew-Explore
    NAME-skew-fit       SAC with Skew-Fit
    NAME-ppo-skew-fit   PPO + LSTM with Skew-Fit
    NAME-ppo-rnd        PPO + LSTM with random network distillation
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from skewmi.train.config import RolloutConfig, TrainConfig
from skewmi.train.exploration.goals import SkewedGoalsConfig
from skewmi.train.exploration.return_then_explore import ReturnThenExploreConfig
from skewmi.train.exploration.rnd import RndConfig
from skewmi.train.exploration.skew_explore import SkewExploreConfig
from skewmi.train.exploration.skew_fit import SkewFitConfig
from skewmi.train.ppo.config import PpoConfig
from skewmi.train.sac.config import SacConfig


@dataclass(frozen=True)
class Methods:
    """What the methods of one kind of preset are made with.

    Attributes:
        ppo: The learner with a memory.
        rollout: How it collects episodes; how many it keeps, the preset says.
        distance_weight: In front of Skew-Fit's distance.
        rnd: Random network distillation; what the task's reward counts, the preset says.
    """

    ppo: PpoConfig
    rollout: RolloutConfig
    distance_weight: float
    rnd: RndConfig

    def presets(self, base: TrainConfig) -> tuple[TrainConfig, ...]:
        """The four other methods, from a preset of Skew-Explore."""
        explore = base.exploration
        assert isinstance(explore, SkewExploreConfig)
        goals = {f.name: getattr(explore, f.name) for f in fields(SkewedGoalsConfig)}
        fit = SkewFitConfig(
            **goals,
            intrinsic=self.distance_weight,
            extrinsic=explore.extrinsic,
            weights_in_reward=explore.weights_in_reward,
        )
        rnd = replace(self.rnd, extrinsic=explore.extrinsic)
        rollout = replace(self.rollout, history_steps=base.rollout.history_steps)
        ppo = replace(base, learner=self.ppo, rollout=rollout)
        return (
            replace(ppo, preset=f"{base.preset}-ppo"),
            replace(base, preset=f"{base.preset}-skew-fit", exploration=fit),
            replace(ppo, preset=f"{base.preset}-ppo-skew-fit", exploration=fit),
            replace(ppo, preset=f"{base.preset}-ppo-rnd", exploration=rnd),
        )


MOST_EVALUATED = 0.68
"""Once a policy seems to be done, 17 of 25 copies tell so within three iterations, and the rest
explores: 30 %."""


def return_then_explore(
    base: TrainConfig,
    *,
    updates_per_step: float,
    arrival_radius: float,
    stall_distance: float,
    revisit_probability: float = 0.0,
    keep_fields: tuple[str, ...] = (),
    burst_updates_per_step: float = 1.6,
) -> TrainConfig:
    """Skew-Explore's goals in excursions, from a preset of Skew-Explore on SAC.

    Random motion happens where an excursion ends, so there is none at the end of episodes.

    Args:
        base: Gives all other numbers.
        updates_per_step: Gradient updates per environment step.
        arrival_radius, stall_distance: See `ReturnThenExploreConfig`, density units.
        revisit_probability, keep_fields: See `ReturnThenExploreConfig`.
        burst_updates_per_step: Gradient updates per environment step from the first reward until
            convergence.
    """
    explore, learner = base.exploration, base.learner
    assert isinstance(explore, SkewExploreConfig)
    assert isinstance(learner, SacConfig)
    same = {f.name: getattr(explore, f.name) for f in fields(SkewExploreConfig)}
    return replace(
        base,
        preset=f"{base.preset}-return-then-explore",
        # Most trajectories to convergence used to come after the first reward.
        learner=replace(
            learner,
            updates_per_step=updates_per_step,
            burst_updates_per_step=burst_updates_per_step,
            burst_rewarded_fraction=0.5,
            # So many updates lie between two iterations that the latest actor is now better, now
            # worse.
            actor_average=0.999,
        ),
        exploration=ReturnThenExploreConfig(
            **same,
            arrival_radius=arrival_radius,
            stall_distance=stall_distance,
            revisit_probability=revisit_probability,
            keep_fields=keep_fields,
        ),
        rollout=replace(base.rollout, noise_probability=0.0, evaluation_share=MOST_EVALUATED),
    )


PAPER = Methods(
    ppo=PpoConfig(
        normalize_input=False,
        # The code's sequences of 500 steps end with their episodes.
        sequence_length=None,
        value_clip=0.2,
        scale_rewards=False,
    ),
    # 5,000 steps an update, as the code's 10 environments of 500, but in whole episodes of 200.
    rollout=RolloutConfig(num_envs=25, evaluation_envs=0, random_steps=0, noise_probability=0.0),
    distance_weight=1.0,
    rnd=RndConfig(intrinsic=1000.0, scale_bonus=False),
)
IMPROVED = Methods(
    ppo=PpoConfig(),
    # The same 5,000 steps, beside two deterministic episodes.
    rollout=RolloutConfig(num_envs=27, evaluation_envs=2, random_steps=0, noise_probability=0.0),
    distance_weight=0.05,
    rnd=RndConfig(),
)
