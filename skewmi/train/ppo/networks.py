"""The network of proximal policy optimization: a memory that policy and value share."""

from __future__ import annotations

import math
from itertools import pairwise

import torch
from torch import Tensor, nn

from skewmi.train.learner import Hidden

_LOG_TWO_PI = math.log(2.0 * math.pi)


def log_density(action: Tensor, mean: Tensor, log_std: Tensor) -> Tensor:
    """log N(action; mean, exp(log_std)^2), summed over the last axis. Shapes (..., d) -> (...)."""
    noise = (action - mean) * torch.exp(-log_std)
    return (-0.5 * noise.square() - log_std - 0.5 * _LOG_TWO_PI).sum(-1)


def gaussian_entropy(log_std: Tensor) -> Tensor:
    """Entropy of a Gaussian with independent components, nats. Shape (..., d) -> (...)."""
    return (log_std + 0.5 * (_LOG_TWO_PI + 1.0)).sum(-1)


def tanh_layers(size: int, hidden: tuple[int, ...], outputs: int) -> nn.Sequential:
    """Linear layers with tanh between them, orthogonal weights, zero offsets.

    Gain sqrt(2) keeps the size of signals through tanh; the last layer's is 1.
    """
    sizes = (size, *hidden)
    layers: list[nn.Module] = []
    for i, o in pairwise(sizes):
        layers += [_orthogonal(nn.Linear(i, o), math.sqrt(2.0)), nn.Tanh()]
    return nn.Sequential(*layers, _orthogonal(nn.Linear(sizes[-1], outputs), 1.0))


def _orthogonal(layer: nn.Linear, gain: float) -> nn.Linear:
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


class ActorCritic(nn.Module):
    """Inputs and memory -> mean action, value, and the next memory.

        inputs -> LSTM -> tanh layers -> mean of the action (its deviation is the same everywhere)
                       -> tanh layers -> value

    Without a memory (0 units) both see the inputs themselves.

    Args:
        input_dim: Size of the inputs.
        action_dim: Size of an action.
        memory: Units of the LSTM, or 0.
        heads: Units of the tanh layers.
        initial_log_std: Of every component of the action.
    """

    def __init__(
        self,
        input_dim: int,
        action_dim: int,
        memory: int,
        heads: tuple[int, ...],
        initial_log_std: float,
    ) -> None:
        super().__init__()
        self.memory = memory
        self.lstm = nn.LSTM(input_dim, memory, batch_first=True) if memory else None
        if self.lstm is not None:
            for name, parameter in self.lstm.named_parameters():
                if name.startswith("weight"):
                    # Each of the four gates is a matrix of its own.
                    for gate in parameter.data.chunk(4):
                        nn.init.orthogonal_(gate)
                else:
                    nn.init.zeros_(parameter)
        features = memory or input_dim
        self.policy = tanh_layers(features, heads, action_dim)
        self.value = tanh_layers(features, heads, 1)
        self.log_std = nn.Parameter(torch.full((action_dim,), initial_log_std))

    def empty(self, n: int) -> Hidden:
        """The memory of n episodes at their start: (h, c), each of shape (n, memory); or ()."""
        if self.lstm is None:
            return ()
        like = self.log_std
        return tuple(like.new_zeros(n, self.memory) for _ in range(2))

    def forward(self, inputs: Tensor, hidden: Hidden) -> tuple[Tensor, Tensor, Hidden]:
        """Go through sequences of steps.

        Args:
            inputs: Shape (n, steps, input_dim).
            hidden: Before the first step, as `empty`.

        Returns:
            Mean actions, shape (n, steps, action_dim), values, shape (n, steps), and the memory
            after the last step.
        """
        features = inputs
        if self.lstm is not None:
            h, c = hidden
            features, (h, c) = self.lstm(inputs, (h[None], c[None]))
            hidden = (h[0], c[0])
        return self.policy(features), self.value(features).squeeze(-1), hidden
