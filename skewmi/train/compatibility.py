"""What does not go together in a run, and is refused before it begins."""

from __future__ import annotations

from skewmi.train.checks import require
from skewmi.train.config import TrainConfig
from skewmi.train.exploration.protocol import Exploration


def require_own_actions(config: TrainConfig, exploration: Exploration) -> None:
    """An on-policy learner learns from what its own policy did, so nothing may replace that.

    Raises:
        ConfigurationError: Something does; the message says what to leave out.
    """
    rollout = config.rollout
    require(
        not config.taught_by,
        "this learner is on-policy: it cannot learn from what a teacher did; leave out --teacher",
    )
    require(
        rollout.random_steps == 0 and rollout.noise_probability == 0.0,
        f"this learner is on-policy: it needs rollout.random_steps 0, not {rollout.random_steps}, "
        f"and rollout.noise_probability 0, not {rollout.noise_probability}",
    )
    require(
        not exploration.moves_at_random,
        "this learner is on-policy: it needs an exploration that leaves all actions to it, say "
        "--exploration.explore-steps 0",
    )


def require_explored(config: TrainConfig, rewarded_episodes: int) -> None:
    """An unrewarded run cannot begin with one whose episodes, goals and networks know the reward.

    Args:
        config: Of the run that begins.
        rewarded_episodes: Of the one that it begins with.

    Raises:
        ConfigurationError: The run is unrewarded, and there are such episodes.
    """
    require(
        config.rewarded or rewarded_episodes == 0,
        f"this run is to be unrewarded, and the one to begin with has met the reward in "
        f"{rewarded_episodes:,} episodes, which would go on being learned from: leave out "
        "--unrewarded, or begin with a run that has met none",
    )
