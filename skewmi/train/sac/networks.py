"""The networks of soft actor-critic: a squashed Gaussian actor and an ensemble of critics."""

from __future__ import annotations

import math
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

_LOG_TWO_PI = math.log(2.0 * math.pi)


def gaussian_log_prob(noise: Tensor, log_std: Tensor) -> Tensor:
    """log N(mean + std * noise; mean, std^2), summed over the last axis.

    Args:
        noise: Standard normal sample. Shape (..., d).
        log_std: Shape (..., d).

    Returns:
        Shape (...).
    """
    return (-0.5 * noise.square() - log_std).sum(-1) - 0.5 * noise.shape[-1] * _LOG_TWO_PI


def tanh_log_slope(u: Tensor) -> Tensor:
    """log |d tanh(u) / du|, summed over the last axis, finite for any u.

    log(1 - tanh(u)^2) = 2 (log 2 - u - softplus(-2u)): no difference of near equals.
    """
    return (2.0 * (math.log(2.0) - u - functional.softplus(-2.0 * u))).sum(-1)


def squashed_sample(mean: Tensor, log_std: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """tanh(u) of a Gaussian u, and its log density, differentiable in mean and deviation.

    Args:
        mean, log_std: Of u. Shape (n, action_dim).
        noise: Standard normal. Shape (n, action_dim).

    Returns:
        Actions in (-1, 1), shape (n, action_dim), and log densities, shape (n,).
    """
    u = mean + log_std.exp() * noise
    return torch.tanh(u), gaussian_log_prob(noise, log_std) - tanh_log_slope(u)


class Actor(nn.Module):
    """Gaussian over u, action = tanh(u): inputs (n, input_dim) -> mean and log std of u."""

    def __init__(
        self,
        input_dim: int,
        action_dim: int,
        hidden: tuple[int, ...],
        log_std_bounds: tuple[float, float],
    ) -> None:
        super().__init__()
        sizes = (input_dim, *hidden)
        layers: list[nn.Module] = []
        for i, o in pairwise(sizes):
            layers += [nn.Linear(i, o), nn.ReLU()]
        layers.append(nn.Linear(sizes[-1], 2 * action_dim))
        self.body = nn.Sequential(*layers)
        self.log_std_bounds = log_std_bounds

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        mean, log_std = self.body(inputs).chunk(2, dim=-1)
        return mean, log_std.clamp(*self.log_std_bounds)

    def sample(self, inputs: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Squashed action and its log density for inputs (n, input_dim), see `squashed_sample`."""
        mean, log_std = self(inputs)
        return squashed_sample(mean, log_std, noise)


class Critics(nn.Module):
    """`members` independent value networks evaluated as one batched product.

    Maps inputs (n, input_dim) to values (members, n). The normalisation before each ReLU has
    no gain and offset of its own: they cost a third of the forward pass at this size.
    """

    def __init__(
        self, members: int, input_dim: int, hidden: tuple[int, ...], layer_norm: bool
    ) -> None:
        super().__init__()
        sizes = (input_dim, *hidden, 1)
        self.members = members
        self.layer_norm = layer_norm
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        for i, o in pairwise(sizes):
            # The same bounds as torch.nn.Linear: uniform in +-1/sqrt(fan in).
            bound = 1.0 / math.sqrt(i)
            self.weights.append(nn.Parameter(torch.empty(members, i, o).uniform_(-bound, bound)))
            self.biases.append(nn.Parameter(torch.empty(members, 1, o).uniform_(-bound, bound)))

    def forward(self, inputs: Tensor) -> Tensor:
        h = inputs.expand(self.members, *inputs.shape)
        last = len(self.weights) - 1
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            h = torch.baddbmm(bias, h, weight)
            if k < last:
                if self.layer_norm:
                    h = functional.layer_norm(h, (h.shape[-1],))
                h = torch.relu(h)
        return h.squeeze(-1)
