"""Collecting whole episodes: goals, actions, noise, evaluation copies."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from skewmi.batch_env import BatchEnv
from skewmi.policy_io import Array
from skewmi.train.beginning import Beginning
from skewmi.train.config import RolloutConfig
from skewmi.train.exploration.protocol import Exploration
from skewmi.train.learner import Hidden, Learner, Rollout
from skewmi.train.noise import ExplorationNoise
from skewmi.train.replay import Episodes


def collect(
    env: BatchEnv,
    learner: Learner,
    exploration: Exploration,
    generator: np.random.Generator,
    *,
    config: RolloutConfig,
    evaluation: int,
    beginning: Beginning | None = None,
    rewarded: bool = True,
) -> Rollout:
    """Run one episode in every environment.

    All episodes begin and end together, so the hidden state of a recurrent policy starts anew
    with every call.

    Args:
        env: Reset here.
        learner: Gives the actions.
        exploration: Gives the goals.
        generator: Of everything random but the policy's own noise.
        config: Says how noisy episodes are.
        evaluation: The first so many episodes are deterministic, see `Exploration.begin`.
        beginning: Gives actions instead of the learner, all or some.
        rewarded: Whether the task's reward is paid.
    """
    n, layout = env.num_envs, env.layout
    steps, dim = layout.episode_steps, layout.action_dim
    exploration.begin(n, evaluation, generator)
    noise = _noise(config, (n, steps, dim), evaluation, generator)
    observations = np.empty((n, steps + 1, layout.observation_dim))
    goals = np.empty((n, steps, exploration.goal_dim))
    actions, rewards = np.empty((n, steps, dim)), np.empty((n, steps))
    observations[:, 0] = env.reset()
    if beginning is not None:
        beginning.begin((n, steps, dim), evaluation, generator)
    hidden: Hidden | None = None
    notes: list[Mapping[str, Array]] = []
    for t in range(steps):
        goals[:, t] = exploration.goals(t, observations[:, t])
        given, chosen = np.zeros((n, dim)), np.zeros(n, np.bool_)
        if beginning is not None:
            given, chosen = beginning.act(t, observations[:, t])
        action = given
        if not chosen.all():
            decision = learner.act(observations[:, t], goals[:, t], hidden, evaluation)
            hidden = decision.hidden
            notes.append(decision.notes)
            own = noise.apply(t, decision.action, exploration.wandering())
            action = np.where(chosen[:, None], given, own)
        result = env.step(action)
        actions[:, t], rewards[:, t] = action, result.reward if rewarded else 0.0
        observations[:, t + 1] = result.observation
    names = notes[0] if notes else ()
    return Rollout(
        episodes=Episodes(observations, actions, goals, rewards),
        evaluation=evaluation,
        notes={name: np.stack([note[name] for note in notes], axis=1) for name in names},
    )


def _noise(
    config: RolloutConfig,
    shape: tuple[int, int, int],
    spared: int,
    generator: np.random.Generator,
) -> ExplorationNoise:
    numbers = (config.noise_probability, config.noise_correlation)
    return ExplorationNoise(shape, *numbers, spared=spared, generator=generator)
