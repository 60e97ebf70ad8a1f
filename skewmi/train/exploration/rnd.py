"""Random network distillation (arXiv:1810.12894): a bonus for states unlike those seen.

A target network f with random weights is never trained; a predictor learns to give the same for
the states that were visited. Where they differ, nobody has been:

    b(s) = mean of (predictor(n(s)) - f(n(s)))^2,     r = w_int b(s) / deviation + w_ext r_ext(s)

n is the running normalization of states. Training and scoring see states through the same n, and
the bonus is in units of the running deviation of its own discounted sums. There are no goals.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.checks import require, require_at_least, require_positive
from skewmi.train.exploration.protocol import ExplorationConfig
from skewmi.train.replay import Episodes, Index, Replay
from skewmi.train.return_scale import ReturnScale
from skewmi.train.running_mean_std import RunningMeanStd
from skewmi.train.state import State

_SLOPE = 0.2
"""Of the target's and the predictor's units below zero."""
_SMALLEST_UNIT = 1e-8
"""Of a field that never changed."""


@dataclass(frozen=True)
class RndConfig(ExplorationConfig):
    """Random network distillation: reward where a predictor errs."""

    intrinsic: float = 1.0
    """w_int, in front of the bonus."""
    extrinsic: float = 1.0
    """w_ext, in front of the task's reward of 1 per step."""
    target: tuple[int, ...] = (32, 64, 64)
    """Units of the random network's hidden layers."""
    predictor: tuple[int, ...] = (32, 64, 64, 128)
    """Units of the predictor's hidden layers."""
    features: int = 1024
    """Outputs of both."""
    learning_rate: float = 1e-4
    """Of Adam, for the predictor."""
    batch_size: int = 500
    """States per update of the predictor."""
    epochs: int = 20
    """Times that the predictor learns from each new state."""
    state_clip: float = 5.0
    """Normalized states are clipped to +- this."""
    scale_bonus: bool = True
    """Divide the bonus by the running standard deviation of its discounted sum."""
    bonus_discount: float = 0.99
    """Of that sum, per control step."""

    def __post_init__(self) -> None:
        super().__post_init__()
        sizes = (*self.target, *self.predictor, self.features, self.batch_size)
        require(
            min(sizes) >= 1 and len(self.predictor) > 0,
            f"target {self.target}, predictor {self.predictor}, features {self.features} and "
            f"batch_size {self.batch_size} need at least 1 each",
        )
        require_at_least(0, self, "epochs")
        require_positive(self, "learning_rate", "state_clip")
        require(
            0.0 <= self.bonus_discount < 1.0,
            f"bonus_discount is {self.bonus_discount}, needs 0 <= it < 1",
        )


def network(size: int, hidden: tuple[int, ...], outputs: int) -> nn.Sequential:
    """Layers with leaky ReLU between them; Glorot's uniform weights, zero offsets."""
    layers: list[nn.Module] = []
    for i, o in pairwise((size, *hidden)):
        layers += [_glorot(nn.Linear(i, o)), nn.LeakyReLU(_SLOPE)]
    return nn.Sequential(*layers, _glorot(nn.Linear((size, *hidden)[-1], outputs)))


def _glorot(layer: nn.Linear) -> nn.Linear:
    nn.init.xavier_uniform_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer


class Distillation:
    """A random network, its predictor, and the normalization through which both see states.

    Args:
        config: See `RndConfig`.
        state_dim: Size of a state.
        seed: Of both networks.
    """

    def __init__(self, config: RndConfig, state_dim: int, seed: int) -> None:
        self.config = config
        self.normalization = RunningMeanStd(state_dim)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.target = network(state_dim, config.target, config.features)
            self.predictor = network(state_dim, config.predictor, config.features)
        self.target.requires_grad_(False)
        self.optimizer = torch.optim.Adam(self.predictor.parameters(), lr=config.learning_rate)

    def normalized(self, states: NDArray[np.floating]) -> Tensor:
        """States (..., d) as both networks see them; float32."""
        n, clip = self.normalization, self.config.state_clip
        unit = np.maximum(np.sqrt(n.variance), _SMALLEST_UNIT)
        return torch.as_tensor(np.clip((states - n.mean) / unit, -clip, clip), dtype=torch.float32)

    def errors(self, states: NDArray[np.floating]) -> Array:
        """Mean squared error of the predictor at states (..., d). Shape (...)."""
        x = self.normalized(states)
        with torch.no_grad():
            error: Array = (self.predictor(x) - self.target(x)).square().mean(-1).double().numpy()
        return error

    def train(self, states: Array, generator: np.random.Generator) -> float:
        """Let the predictor learn states (n, d); its mean loss over the last epoch."""
        x, c = self.normalized(states), self.config
        with torch.no_grad():
            y = self.target(x)
        loss_sum = 0.0
        for _ in range(c.epochs):
            order = torch.as_tensor(generator.permutation(len(x)))
            loss_sum = 0.0
            for index in torch.split(order, c.batch_size):
                loss = (self.predictor(x[index]) - y[index]).square().mean()
                self.optimizer.zero_grad()
                loss.backward()
                self.optimizer.step()
                loss_sum += loss.item() * len(index)
        return loss_sum / len(x)

    def state_dict(self) -> State:
        """All that a continuation needs."""
        moments = self.optimizer.state_dict()["state"]
        return {
            "normalization": self.normalization.state_dict(),
            "target": self.target.state_dict(),
            "predictor": self.predictor.state_dict(),
            "optimizer": {str(index): dict(entry) for index, entry in moments.items()},
        }

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`."""
        self.normalization.load_state_dict(state["normalization"])
        try:
            self.target.load_state_dict(state["target"])
            self.predictor.load_state_dict(state["predictor"])
        except RuntimeError as error:
            raise ValueError(f"of other networks: {error}") from error
        moments = {int(index): dict(entry) for index, entry in state["optimizer"].items()}
        self.optimizer.load_state_dict({**self.optimizer.state_dict(), "state": moments})


class Rnd:
    """Satisfies `Exploration`, without goals.

    A state's bonus is the error at the time that it was reached, before the predictor learned it:
    it is the trajectory term that is stored with the episodes.
    """

    goal_dim = 0
    moves_at_random = False
    metrics: tuple[str, ...] = ("novelty", "predictor_loss")

    def __init__(
        self, config: RndConfig, layout: PolicyLayout, generator: np.random.Generator
    ) -> None:
        self.config = config
        self.extrinsic_weight = config.extrinsic
        self.evaluation_goal: Array = np.zeros(0)
        self.proposals: Array = np.zeros((0, 0))
        self.proposal_episodes: Index = np.zeros(0, dtype=np.int64)
        self.state_dim = layout.state_dim
        self.distillation = Distillation(
            config, layout.state_dim, int(generator.integers(2**63 - 1))
        )
        self.scale = ReturnScale(config.bonus_discount)
        self._episodes = 0
        # Reached since the last refresh; none between two iterations, where checkpoints are.
        self._fresh: list[Array] = []
        self._novelty = 0.0
        self.refreshes = 0

    def begin(self, episodes: int, evaluation: int, generator: np.random.Generator) -> None:
        """There is nothing to choose."""
        self._episodes = episodes

    def goals(self, step: int, observations: Array) -> Array:
        """None. Shape (episodes, 0)."""
        return np.zeros((self._episodes, 0))

    def wandering(self) -> NDArray[np.bool_] | None:
        """Nobody."""
        return None

    def observe(self, episodes: Episodes) -> Array:
        """The predictor's error at every reached state. Shape (episodes, steps)."""
        states = episodes.observations[:, 1:, : self.state_dim]
        flat = states.reshape(-1, self.state_dim)
        # Scored as the predictor last learned, so only the first states are normalized by
        # themselves.
        normalization = self.distillation.normalization
        first = normalization.count == 0.0
        if first:
            normalization.update(flat)
        errors = self.distillation.errors(states)
        if not first:
            normalization.update(flat)
        self.scale.update(errors)
        self._fresh.append(flat)
        self._novelty = float(errors.mean())
        return errors

    def intrinsic_reward(
        self,
        states: NDArray[np.floating],
        goals: NDArray[np.floating],
        trajectory_term: NDArray[np.floating],
    ) -> Array:
        """w_int times the bonus, see `Exploration`."""
        unit = self.scale.deviation if self.config.scale_bonus else 1.0
        reward: Array = self.config.intrinsic / unit * np.asarray(trajectory_term, np.float64)
        return reward

    def refresh(
        self, history: Replay, steps: int, generator: np.random.Generator
    ) -> dict[str, float]:
        """The predictor learns what was reached since the last time."""
        if not self._fresh:
            return {}
        loss = self.distillation.train(np.concatenate(self._fresh), generator)
        self._fresh = []
        self.refreshes += 1
        return {"novelty": self._novelty, "predictor_loss": loss}

    def state_dict(self) -> State:
        """All that a continuation needs."""
        return {
            **self.distillation.state_dict(),
            "scale": self.scale.state_dict(),
            "refreshes": self.refreshes,
        }

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`."""
        self.distillation.load_state_dict(state)
        self.scale.load_state_dict(state["scale"])
        # Checkpoints of earlier versions do not tell: counted from there.
        self.refreshes = int(state.get("refreshes", 0))
