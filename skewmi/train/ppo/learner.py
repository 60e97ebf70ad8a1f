"""Proximal policy optimization with a memory, as the runner uses it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.exploration.protocol import Exploration, total_reward
from skewmi.train.inputs import InputNormalizer
from skewmi.train.learner import Decision, Hidden, Rollout
from skewmi.train.ppo.advantages import advantages, explained_variance
from skewmi.train.ppo.config import PpoConfig
from skewmi.train.ppo.module import PpoPolicyModule
from skewmi.train.ppo.ppo import Ppo
from skewmi.train.ppo.sequences import Sequences, cut
from skewmi.train.replay import Replay
from skewmi.train.return_scale import ReturnScale
from skewmi.train.state import State, as_array

_MEMORY = ("h", "c")
"""Notes that hold the memory before every step."""

Collected = dict[str, Array]
"""Episodes of one iteration that wait for an update, by name: shape (n, steps, ...)."""


class PpoLearner:
    """Satisfies `Learner`: on-policy, with a memory.

    Collected episodes wait until there are enough, so a checkpoint may hold some, with the memory
    before each of their steps.
    """

    metrics: tuple[str, ...] = (
        "policy_loss",
        "value_loss",
        "policy_entropy",
        "divergence",
        "clipped_fraction",
        "gradient_norm",
        "explained_variance",
        "return_deviation",
    )
    on_policy = True
    hurry = False

    def __init__(
        self, config: PpoConfig, layout: PolicyLayout, goal_dim: int, seed: int, device: str
    ) -> None:
        self.config = config
        self.state_dim = layout.state_dim
        self.inputs = InputNormalizer(layout, goal_dim, normalize=config.normalize_input)
        self.ppo = Ppo(config, self.inputs.dim, layout.action_dim, seed, device)
        self.scale = ReturnScale(config.discount)
        self.waiting: list[Collected] = []

    @property
    def updates(self) -> int:
        """Gradient updates so far."""
        return self.ppo.updates

    def act(
        self, observations: Array, goals: Array, hidden: Hidden | None, evaluation: int
    ) -> Decision:
        """A sample of the policy, and its mean action for the evaluation episodes."""
        x = self.inputs(observations, goals).to(self.ppo.device)
        before = self.ppo.network.empty(len(x)) if hidden is None else hidden
        action, log_density, values, after = self.ppo.act(x, before, evaluation)
        notes = {
            "drawn": _array(action),
            "log_density": _array(log_density),
            "value": _array(values),
            **{name: _array(part) for name, part in zip(_MEMORY, before, strict=False)},
        }
        return Decision(np.clip(notes["drawn"].astype(np.float64), -1.0, 1.0), after, notes)

    def observe(self, rollout: Rollout, trajectory_term: Array) -> None:
        """Keep finished episodes; deterministic ones are not the policy's."""
        episodes = rollout.episodes
        collected = {
            "observations": episodes.observations,
            "goals": episodes.goals,
            "rewards": episodes.rewards,
            "trajectory_term": trajectory_term,
            **rollout.notes,
        }
        kept = {name: values[rollout.evaluation :] for name, values in collected.items()}
        self.waiting.append(kept)

    def update(
        self, history: Replay, exploration: Exploration, generator: np.random.Generator
    ) -> dict[str, float]:
        """Learn from all episodes that wait, once there are enough; means over the updates."""
        if sum(part["rewards"].size for part in self.waiting) < self.config.steps_per_update:
            return {}
        names = self.waiting[0]
        collected = {name: np.concatenate([p[name] for p in self.waiting]) for name in names}
        self.waiting = []
        rewards = self._rewards(collected, exploration)
        self.scale.update(rewards)
        unit = self.scale.deviation if self.config.scale_rewards else 1.0
        batch, explained = self.sequences(collected, rewards / unit)
        return {
            **self.ppo.update(batch),
            "explained_variance": explained,
            "return_deviation": self.scale.deviation,
        }

    def _rewards(self, collected: Collected, exploration: Exploration) -> Array:
        """What there is to maximize, towards the goals of that time. Shape (n, steps)."""
        states = collected["observations"][:, 1:, : self.state_dim]
        return total_reward(
            exploration,
            states,
            collected["goals"],
            collected["trajectory_term"],
            collected["rewards"],
        )

    def sequences(self, collected: Collected, rewards: Array) -> tuple[Sequences, float]:
        """Collected episodes as sequences, and how much of their returns the value explains.

        Args:
            collected: Of whole episodes.
            rewards: What there is to maximize, in the value's unit. Shape (n, steps).
        """
        c, goals = self.config, collected["goals"]
        inputs = self._tensor(
            # After the last step an episode would have gone on towards the same goal.
            self.inputs(collected["observations"], np.concatenate((goals, goals[:, -1:]), axis=1))
        )
        memory = [self._tensor(collected[name]) for name in _MEMORY if name in collected]
        last = self.ppo.values(inputs[:, -2:], tuple(part[:, -1] for part in memory))[:, 1:]
        values = collected["value"].astype(np.float64)
        next_values = np.concatenate((values[:, 1:], _array(last).astype(np.float64)), axis=1)
        ends = np.zeros(rewards.shape, dtype=np.bool_)
        ends[:, -1] = True
        never = np.zeros_like(ends)
        ahead = advantages(
            rewards,
            values,
            next_values,
            never if c.bootstrap_at_timeout else ends,
            ends,
            discount=c.discount,
            trace_decay=c.trace_decay,
        )
        returns = ahead + values
        steps = rewards.shape[1]
        length = min(steps, c.sequence_length or steps)
        pieces = {
            "inputs": inputs[:, :-1],
            "actions": self._tensor(collected["drawn"]),
            "log_density": self._tensor(collected["log_density"]),
            "advantages": self._tensor(ahead),
            "returns": self._tensor(returns),
            "values": self._tensor(values),
            "real": torch.ones(rewards.shape, dtype=torch.bool, device=self.ppo.device),
        }
        hidden = tuple(part[:, ::length].flatten(0, 1) for part in memory)
        batch = Sequences(
            **{name: cut(values, length) for name, values in pieces.items()}, hidden=hidden
        )
        return batch, explained_variance(values, returns)

    def _tensor(self, values: Array | Tensor) -> Tensor:
        return torch.as_tensor(values, dtype=torch.float32).to(self.ppo.device)

    def policy_module(self, goal: Array) -> nn.Module:
        """The mean action towards a goal, clipped, and the memory that goes with it."""
        return PpoPolicyModule(self.ppo.network, self.inputs, goal)

    def state_dict(self) -> State:
        """All that an identical continuation needs."""
        return {
            **self.ppo.state_dict(),
            "scale": self.scale.state_dict(),
            "waiting": {str(number): part for number, part in enumerate(self.waiting)},
        }

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`."""
        self.ppo.load_state_dict(state)
        self.scale.load_state_dict(state["scale"])
        waiting = state["waiting"]
        self.waiting = [
            {name: as_array(values) for name, values in waiting[str(number)].items()}
            for number in range(len(waiting))
        ]


def _array(values: Tensor) -> Array:
    result: Array = values.cpu().numpy()
    return result
