"""Collecting whole episodes: goals, actions, noise, evaluation copies."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from skewmi.batch_env import BatchEnv
from skewmi.policy_io import Array
from skewmi.train.beginning import Beginning
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
    evaluation: int,
    noise_probability: float,
    noise_correlation: float,
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
        evaluation: The first so many episodes are deterministic, see `Exploration.begin`.
        noise_probability, noise_correlation: See `ExplorationNoise`.
        beginning: Gives actions instead of the learner, all or some.
        rewarded: Whether the task's reward is paid.
    """
    n, layout = env.num_envs, env.layout
    steps, dim = layout.episode_steps, layout.action_dim
    exploration.begin(n, evaluation, generator)
    noise = ExplorationNoise(
        (n, steps, dim),
        probability=noise_probability,
        correlation=noise_correlation,
        spared=evaluation,
        generator=generator,
    )
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
        given = beginning.act(t, observations[:, t]) if beginning is not None else None
        if given is not None and given[1].all():
            action = given[0]
        else:
            decision = learner.act(observations[:, t], goals[:, t], hidden, evaluation)
            hidden = decision.hidden
            notes.append(decision.notes)
            action = noise.apply(t, decision.action, exploration.wandering())
            if given is not None:
                action = np.where(given[1][:, None], given[0], action)
        result = env.step(action)
        actions[:, t], rewards[:, t] = action, result.reward if rewarded else 0.0
        observations[:, t + 1] = result.observation
    names = notes[0] if notes else ()
    return Rollout(
        episodes=Episodes(observations, actions, goals, rewards),
        evaluation=evaluation,
        notes={name: np.stack([note[name] for note in notes], axis=1) for name in names},
    )
