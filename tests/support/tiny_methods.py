"""A recurrent on-policy learner and an exploration without goals, as small as they can be.

They plug into the very runner that trains everything else, and show what its seams leave room
for: hidden states in rollout, checkpoint and export; episodes pending in a checkpoint; intrinsic
rewards that need no goals; networks or counts of an exploration that are renewed as it goes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.exploration.protocol import Exploration, ExplorationConfig, total_reward
from skewmi.train.inputs import InputNormalizer
from skewmi.train.learner import Decision, Hidden, LearnerConfig, Rollout
from skewmi.train.replay import Episodes, Index, Replay
from skewmi.train.state import State, as_array


@dataclass(frozen=True)
class ReinforceConfig(LearnerConfig):
    """Policy gradients through an LSTM."""

    hidden: int = 8
    """Units of the LSTM."""
    learning_rate: float = 3e-3
    """Of Adam."""
    steps_per_update: int = 400
    """Environment steps collected before each update."""
    chunk: int = 10
    """Steps that gradients flow back through; earlier ones are in the stored hidden state."""
    log_std: float = -0.5
    """Of the actions before squashing."""


class LstmNetwork(nn.Module):
    """Inputs (n, input_dim) and hidden state -> mean before squashing, and the next state."""

    def __init__(self, input_dim: int, action_dim: int, hidden: int) -> None:
        super().__init__()
        self.cell = nn.LSTMCell(input_dim, hidden)
        self.head = nn.Linear(hidden, action_dim)

    def forward(self, inputs: Tensor, h: Tensor, c: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        h, c = self.cell(inputs, (h, c))
        return self.head(h), h, c


class LstmPolicyModule(nn.Module):
    """(observation, h, c) -> (action, h, c), towards one goal."""

    def __init__(self, network: LstmNetwork, inputs: InputNormalizer, goal: Array) -> None:
        super().__init__()
        self.network = network
        size = network.cell.hidden_size
        self.state_sizes = (size, size)
        n = inputs.observation_dim
        self.register_buffer("center", torch.as_tensor(inputs.center[:n]).float())
        self.register_buffer("scale", torch.as_tensor(inputs.half[:n]).float())
        scaled = (goal - inputs.center[n:]) / inputs.half[n:]
        self.register_buffer("goal", torch.as_tensor(scaled).float())

    def forward(self, observation: Tensor, h: Tensor, c: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        goal = self.goal.expand(observation.shape[0], -1)
        x = torch.cat(((observation - self.center) / self.scale, goal), dim=-1)
        mean, h, c = self.network(x, h, c)
        return torch.tanh(mean), h, c


class Reinforce:
    """Satisfies `Learner`: on-policy, recurrent.

    The gradient of sum_t log pi(u_t | history) (G_t - mean G), with G_t the reward still to come.
    Collected episodes wait until there are enough, so a checkpoint may hold some.
    """

    metrics = ("policy_loss", "ratio_error")
    on_policy = True
    hurry = False

    def __init__(
        self, config: ReinforceConfig, layout: PolicyLayout, goal_dim: int, seed: int, device: str
    ) -> None:
        self.config = config
        self.state_dim = layout.state_dim
        self.inputs = InputNormalizer(layout, goal_dim, normalize=True)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network = LstmNetwork(self.inputs.dim, layout.action_dim, config.hidden)
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate)
        self.generator = torch.Generator().manual_seed(seed)
        self.updates = 0
        self.pending: list[dict[str, Array]] = []

    def act(
        self, observations: Array, goals: Array, hidden: Hidden | None, evaluation: int
    ) -> Decision:
        x = self.inputs(observations, goals)
        if hidden is None:
            hidden = tuple(torch.zeros(len(x), self.config.hidden) for _ in range(2))
        with torch.no_grad():
            mean, *after = self.network(x, *hidden)
        noise = torch.randn(mean.shape, generator=self.generator)
        noise[:evaluation] = 0.0
        u = mean + math.exp(self.config.log_std) * noise
        before = {name: state.numpy() for name, state in zip("hc", hidden, strict=True)}
        notes = {"u": u.numpy(), "log_prob": self._log_prob(u, mean).numpy(), **before}
        return Decision(torch.tanh(u).double().numpy(), tuple(after), notes)

    def _log_prob(self, u: Tensor, mean: Tensor) -> Tensor:
        """Up to a constant."""
        return (-0.5 * ((u - mean) / math.exp(self.config.log_std)).square()).sum(-1)

    def observe(self, rollout: Rollout, trajectory_term: Array) -> None:
        episodes, n = rollout.episodes, rollout.evaluation
        mine = {
            "observations": episodes.observations,
            "goals": episodes.goals,
            "rewards": episodes.rewards,
            "term": trajectory_term,
            **rollout.notes,
        }
        # Deterministic episodes are not the policy's.
        self.pending.append({name: values[n:] for name, values in mine.items()})

    def update(
        self, history: Replay, exploration: Exploration, generator: np.random.Generator
    ) -> dict[str, float]:
        if sum(p["rewards"].size for p in self.pending) < self.config.steps_per_update:
            return {}
        all_of = {k: np.concatenate([p[k] for p in self.pending]) for k in self.pending[0]}
        self.pending = []
        states = all_of["observations"][:, 1:, : self.state_dim]
        rewards = total_reward(
            exploration, states, all_of["goals"], all_of["term"], all_of["rewards"]
        )
        to_come = np.flip(np.cumsum(np.flip(rewards, 1), 1), 1)
        advantage = torch.as_tensor(to_come - to_come.mean(0)).float()
        x = self.inputs(all_of["observations"][:, :-1], all_of["goals"])
        u, recorded = (torch.as_tensor(all_of[k]) for k in ("u", "log_prob"))
        log_prob = torch.empty_like(recorded)
        chunk, steps = self.config.chunk, x.shape[1]
        for begin in range(0, steps, chunk):
            # Gradients stop here; the value is the one that the rollout had.
            hidden = [torch.as_tensor(all_of[k][:, begin]) for k in "hc"]
            for t in range(begin, min(begin + chunk, steps)):
                mean, *hidden = self.network(x[:, t], *hidden)
                log_prob[:, t] = self._log_prob(u[:, t], mean)
        loss = -(log_prob * advantage).mean()
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        self.updates += 1
        # On-policy: before the first step, old and new densities are equal.
        ratio = (log_prob.detach() - recorded).exp()
        return {"policy_loss": loss.item(), "ratio_error": (ratio - 1.0).abs().max().item()}

    def policy_module(self, goal: Array) -> nn.Module:
        return LstmPolicyModule(self.network, self.inputs, goal)

    def state_dict(self) -> State:
        moments = self.optimizer.state_dict()["state"]
        return {
            "network": self.network.state_dict(),
            "optimizer": {str(k): dict(entry) for k, entry in moments.items()},
            "generator": self.generator.get_state(),
            "updates": self.updates,
            "pending": {str(k): episodes for k, episodes in enumerate(self.pending)},
        }

    def load_state_dict(self, state: State) -> None:
        self.network.load_state_dict(state["network"])
        moments = {int(k): dict(entry) for k, entry in state["optimizer"].items()}
        self.optimizer.load_state_dict({**self.optimizer.state_dict(), "state": moments})
        self.generator.set_state(state["generator"])
        self.updates = int(state["updates"])
        pending = state["pending"]
        self.pending = [
            {name: as_array(values) for name, values in pending[str(k)].items()}
            for k in range(len(pending))
        ]


@dataclass(frozen=True)
class CountBonusConfig(ExplorationConfig):
    """A bonus for what was seldom visited."""

    intrinsic: float = 0.1
    """In front of 1 / sqrt(visits of the cell)."""
    cell: float = 0.5
    """Side of a cell, in the units of the state."""


class CountBonus:
    """Satisfies `Exploration`, without goals."""

    goal_dim = 0
    moves_at_random = False
    extrinsic_weight = 1.0
    metrics = ("cells",)

    def __init__(
        self, config: CountBonusConfig, layout: PolicyLayout, generator: np.random.Generator
    ) -> None:
        self.config, self.state_dim = config, layout.state_dim
        self.evaluation_goal: Array = np.zeros(0)
        self.proposals: Array = np.zeros((0, 0))
        self.proposal_episodes: Index = np.zeros(0, dtype=np.int64)
        self.episodes = 0
        self.refreshes = 0
        self.cells: Array = np.zeros((0, layout.state_dim))
        self.counts: Array = np.zeros(0)

    def begin(self, episodes: int, evaluation: int, generator: np.random.Generator) -> None:
        self.episodes = episodes

    def goals(self, step: int, observations: Array) -> Array:
        return np.zeros((self.episodes, 0))

    def wandering(self) -> None:
        return None

    def observe(self, episodes: Episodes) -> Array:
        """What the states were worth when they were reached."""
        states = episodes.observations[:, 1:, : self.state_dim]
        return self._novelty(states)

    def intrinsic_reward(
        self,
        states: NDArray[np.floating],
        goals: NDArray[np.floating],
        trajectory_term: NDArray[np.floating],
    ) -> Array:
        """What they are worth by now: the stored term is not needed."""
        return self.config.intrinsic * self._novelty(states)

    def _novelty(self, states: NDArray[np.floating]) -> Array:
        cells = np.floor(np.asarray(states) / self.config.cell)
        flat = cells.reshape(-1, self.state_dim)
        known = (flat[:, None] == self.cells[None]).all(-1)
        visits = known @ self.counts if len(self.counts) else np.zeros(len(flat))
        return (1.0 / np.sqrt(1.0 + visits)).reshape(states.shape[:-1])

    def refresh(
        self, history: Replay, steps: int, generator: np.random.Generator
    ) -> dict[str, float]:
        states, _ = history.random_states(500, generator)
        cells = np.floor(states / self.config.cell)
        self.cells, self.counts = np.unique(cells, axis=0, return_counts=True)
        self.counts = self.counts.astype(np.float64)
        self.refreshes += 1
        return {"cells": float(len(self.cells))}

    def state_dict(self) -> State:
        return {"cells": self.cells, "counts": self.counts, "refreshes": self.refreshes}

    def load_state_dict(self, state: State) -> None:
        self.cells, self.counts = as_array(state["cells"]), as_array(state["counts"])
        self.refreshes = state["refreshes"]
