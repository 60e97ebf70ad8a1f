"""Collecting whole episodes: goals, switching, random tails, evaluation copies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skewmi.batch_env import BatchEnv
from skewmi.policy_io import Array
from skewmi.train.config import RolloutConfig
from skewmi.train.inputs import InputNormalizer
from skewmi.train.replay import Episodes
from skewmi.train.sac.sac import Sac


@dataclass(frozen=True)
class GoalSource:
    """Where goals come from.

    Attributes:
        proposals: Of the skewed density. Shape (k, state_dim).
        rewarded: Rewarded states that may be given as goals. Shape (m, state_dim), m may be 0.
        evaluation_goal: The one that evaluation episodes get. Shape (state_dim,).
        rewarded_goal_probability: Probability that an episode is given a rewarded state.
    """

    proposals: Array
    rewarded: Array
    evaluation_goal: Array
    rewarded_goal_probability: float

    def draw(self, count: int, generator: np.random.Generator) -> tuple[Array, NDArray[np.bool_]]:
        """Goals (count, state_dim), and which of them are rewarded states."""
        goals = self.proposals[generator.integers(len(self.proposals), size=count)]
        rewarded = generator.random(count) < self.rewarded_goal_probability
        if not len(self.rewarded):
            return goals, np.zeros(count, dtype=np.bool_)
        chosen = self.rewarded[generator.integers(len(self.rewarded), size=count)]
        return np.where(rewarded[:, None], chosen, goals), rewarded


def plan_goals(
    source: GoalSource,
    num_envs: int,
    steps: int,
    evaluation: int,
    switch_probability: float,
    generator: np.random.Generator,
) -> Array:
    """Goal of every step of a batch of episodes.

    The first `evaluation` episodes keep the evaluation goal. The others start with a draw and,
    unless that gave a rewarded state, change to another proposal with `switch_probability` at
    every step: the policy then learns to go from one region to the next, not only from the
    start.

    Returns:
        Shape (num_envs, steps, state_dim).
    """
    first, rewarded = source.draw(num_envs, generator)
    switch = generator.random((num_envs, steps)) < switch_probability
    switch[rewarded] = False
    switch[:, 0] = True
    fresh = source.proposals[generator.integers(len(source.proposals), size=(num_envs, steps))]
    fresh[:, 0] = first
    # Index of the latest switch at or before every step.
    latest = np.maximum.accumulate(np.where(switch, np.arange(steps), 0), axis=1)
    goals: Array = np.take_along_axis(fresh, latest[:, :, None], axis=1)
    goals[:evaluation] = source.evaluation_goal
    return goals


class ExplorationNoise:
    """Correlated random actions from a drawn step of an episode to its end.

    a_t = rho a_{t-1} + sqrt(1 - rho^2) e_t with e_t standard normal: stays away from the
    policy's habits for long enough to get somewhere, which white noise does not.
    """

    def __init__(
        self,
        num_envs: int,
        steps: int,
        action_dim: int,
        config: RolloutConfig,
        generator: np.random.Generator,
    ) -> None:
        self.correlation = config.noise_correlation
        self.generator = generator
        begin = generator.integers(0, steps, size=num_envs)
        self.begin = np.where(generator.random(num_envs) < config.noise_probability, begin, steps)
        self.begin[: config.evaluation_envs] = steps
        self.noise: Array = generator.standard_normal((num_envs, action_dim))

    def apply(self, step: int, action: Array) -> Array:
        """Replace the actions of the episodes whose tail has begun."""
        innovation = self.generator.standard_normal(self.noise.shape)
        self.noise = self.correlation * self.noise + np.sqrt(1 - self.correlation**2) * innovation
        chosen = (step >= self.begin)[:, None]
        return np.where(chosen, np.clip(self.noise, -1.0, 1.0), action)


def collect(
    env: BatchEnv,
    sac: Sac,
    inputs: InputNormalizer,
    source: GoalSource,
    config: RolloutConfig,
    generator: np.random.Generator,
    *,
    random_actions: bool,
) -> Episodes:
    """Run one episode in every environment.

    Args:
        env: Reset here.
        sac: Gives the actions.
        inputs: Of its networks.
        source: Of the goals.
        config: See `RolloutConfig`.
        generator: Of everything random but the policy's own noise.
        random_actions: Uniform actions instead of the policy's.
    """
    n, layout = env.num_envs, env.layout
    steps, dim = layout.episode_steps, layout.action_dim
    evaluation = config.evaluation_envs
    goals = plan_goals(source, n, steps, evaluation, config.switch_probability, generator)
    tail = ExplorationNoise(n, steps, dim, config, generator)
    observations = np.empty((n, steps + 1, layout.observation_dim))
    actions, rewards = np.empty((n, steps, dim)), np.empty((n, steps))
    observations[:, 0] = env.reset()
    for t in range(steps):
        if random_actions:
            action = generator.uniform(-1.0, 1.0, (n, dim))
        else:
            x = inputs(observations[:, t], goals[:, t]).to(sac.device)
            action = sac.act(x).double().cpu().numpy()
            if evaluation:
                mean = sac.act(x[:evaluation], deterministic=True)
                action[:evaluation] = mean.double().cpu().numpy()
            action = tail.apply(t, action)
        result = env.step(action)
        actions[:, t], rewards[:, t] = action, result.reward
        observations[:, t + 1] = result.observation
    return Episodes(observations, actions, goals, rewards)
