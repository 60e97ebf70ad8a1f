"""Collecting whole episodes: goals, actions, noise, evaluation copies."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from skewmi.batch_env import BatchEnv
from skewmi.policy_io import Array
from skewmi.train.exploration.protocol import Exploration
from skewmi.train.learner import Hidden, Learner, Rollout
from skewmi.train.replay import Episodes


class ExplorationNoise:
    """Correlated random actions from a drawn step of an episode to its end.

    a_t = rho a_{t-1} + sqrt(1 - rho^2) e_t with e_t standard normal: stays away from the
    policy's habits for long enough to get somewhere, which white noise does not.

    Args:
        shape: Episodes, steps of each, size of an action.
        probability: That an episode ends so.
        correlation: rho.
        spared: The first so many episodes get none.
        generator: Of everything random here.
    """

    def __init__(
        self,
        shape: tuple[int, int, int],
        *,
        probability: float,
        correlation: float,
        spared: int,
        generator: np.random.Generator,
    ) -> None:
        num_envs, steps, action_dim = shape
        self.correlation = correlation
        self.generator = generator
        begin = generator.integers(0, steps, size=num_envs)
        self.begin = np.where(generator.random(num_envs) < probability, begin, steps)
        self.begin[:spared] = steps
        self.noise: Array = generator.standard_normal((num_envs, action_dim))

    def apply(self, step: int, action: Array, wandering: NDArray[np.bool_] | None = None) -> Array:
        """Replace the actions of the episodes whose noise has begun, and of some others.

        Args:
            step: Of the episodes.
            action: The policy's. Shape (n, action_dim).
            wandering: The others. Shape (n,).
        """
        innovation = self.generator.standard_normal(self.noise.shape)
        self.noise = self.correlation * self.noise + np.sqrt(1 - self.correlation**2) * innovation
        chosen = step >= self.begin
        if wandering is not None:
            chosen = chosen | wandering
        return np.where(chosen[:, None], np.clip(self.noise, -1.0, 1.0), action)


def collect(
    env: BatchEnv,
    learner: Learner,
    exploration: Exploration,
    generator: np.random.Generator,
    *,
    evaluation: int,
    noise_probability: float,
    noise_correlation: float,
    random_actions: bool,
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
        random_actions: Uniform actions instead of the policy's.
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
    hidden: Hidden | None = None
    notes: list[Mapping[str, Array]] = []
    for t in range(steps):
        goals[:, t] = exploration.goals(t, observations[:, t])
        if random_actions:
            action = generator.uniform(-1.0, 1.0, (n, dim))
        else:
            decision = learner.act(observations[:, t], goals[:, t], hidden, evaluation)
            hidden = decision.hidden
            notes.append(decision.notes)
            action = noise.apply(t, decision.action, exploration.wandering())
        result = env.step(action)
        actions[:, t], rewards[:, t] = action, result.reward if rewarded else 0.0
        observations[:, t + 1] = result.observation
    names = notes[0] if notes else ()
    return Rollout(
        episodes=Episodes(observations, actions, goals, rewards),
        evaluation=evaluation,
        notes={name: np.stack([note[name] for note in notes], axis=1) for name in names},
    )
