"""Soft actor-critic with hindsight, as the runner uses it."""

from __future__ import annotations

import numpy as np
from torch import Tensor, nn

from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.exploration.protocol import Exploration, total_reward
from skewmi.train.inputs import InputNormalizer
from skewmi.train.learner import Decision, Hidden, Rollout
from skewmi.train.replay import Replay
from skewmi.train.sac.config import SacConfig
from skewmi.train.sac.hindsight import make_batch, relabel
from skewmi.train.sac.module import SacPolicyModule
from skewmi.train.sac.sac import Batch, Sac
from skewmi.train.state import State

_BATCHES_PER_DRAW = 32
"""Batches drawn and relabelled at once: numpy's overhead per call is that of one batch."""


class SacLearner:
    """Satisfies `Learner`: off-policy, without memory; learns from the whole history."""

    metrics: tuple[str, ...] = (
        "critic_loss",
        "actor_loss",
        "value",
        "temperature",
        "policy_entropy",
    )
    on_policy = False

    def __init__(
        self, config: SacConfig, layout: PolicyLayout, goal_dim: int, seed: int, device: str
    ) -> None:
        self.config = config
        self.inputs = InputNormalizer(layout, goal_dim, normalize=config.normalize_input)
        self.sac = Sac(config, self.inputs.dim, layout.action_dim, seed, device)
        self.hurry = False
        self._owed = 0.0  # updates, for the environment steps observed

    @property
    def updates(self) -> int:
        """Gradient updates so far."""
        return self.sac.updates

    def act(
        self, observations: Array, goals: Array, hidden: Hidden | None, evaluation: int
    ) -> Decision:
        """A sample of the policy, and its mean action for the evaluation episodes."""
        x = self.inputs(observations, goals).to(self.sac.device)
        action = self.sac.act(x).double().cpu().numpy()
        if evaluation:
            mean = self.sac.act(x[:evaluation], deterministic=True)
            action[:evaluation] = mean.double().cpu().numpy()
        return Decision(action)

    def observe(self, rollout: Rollout, trajectory_term: Array) -> None:
        """The history has the episodes; here only the updates for them are owed."""
        c = self.config
        burst = c.burst_updates_per_step if self.hurry else None
        per_step = c.updates_per_step if burst is None else burst
        self._owed += per_step * rollout.episodes.rewards.size

    def update(
        self, history: Replay, exploration: Exploration, generator: np.random.Generator
    ) -> dict[str, float]:
        """All whole updates owed; means of their metrics."""
        owed = int(self._owed)
        self._owed -= owed
        size, sums = self.config.batch_size, dict[str, Tensor]()
        for begin in range(0, owed, _BATCHES_PER_DRAW):
            count = min(_BATCHES_PER_DRAW, owed - begin)
            batch = self.draw(size * count, history, exploration, generator)
            for k in range(count):
                for name, value in self.sac.update(batch.part(k * size, (k + 1) * size)).items():
                    sums[name] = sums[name] + value if name in sums else value
        return {name: float(value) / owed for name, value in sums.items()}

    def draw(
        self, count: int, history: Replay, exploration: Exploration, generator: np.random.Generator
    ) -> Batch:
        """Transitions of the history, relabelled and rewarded anew."""
        c = self.config
        burst = c.burst_rewarded_fraction if self.hurry else None
        drawn = history.draw(
            count,
            c.n_step,
            c.rewarded_fraction if burst is None else burst,
            generator,
            rare=exploration.proposal_episodes,
            rare_fraction=c.rare_fraction,
        )
        goals = relabel(
            drawn,
            history,
            exploration.proposals,
            c.future_fraction,
            c.proposal_fraction,
            generator,
        )
        rewards = total_reward(
            exploration, drawn.states, goals[:, None, :], drawn.trajectory_term, drawn.rewards
        )
        return make_batch(
            drawn,
            goals,
            rewards,
            self.inputs,
            discount=c.discount,
            bootstrap_at_timeout=c.bootstrap_at_timeout,
            device=self.sac.device,
        )

    def policy_module(self, goal: Array) -> nn.Module:
        """The mean action towards a goal."""
        return SacPolicyModule(self.sac.steady_actor, self.inputs, goal)

    def state_dict(self) -> State:
        """All that an identical continuation needs."""
        return {**self.sac.state_dict(), "owed": self._owed}

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`."""
        self.sac.load_state_dict(state)
        self._owed = float(state["owed"])
