"""Soft actor-critic as one writes it down in plain torch: a witness that shares no code with ours.

Modules of linear layers, two critics one after the other, `backward`, torch's default Adam, a loop
over parameters for the target critics. Nothing is stacked, fused or left out for speed. The
algorithm is that of `skewmi.train.sac`: it computes the same update, which a test holds, so that
times of the two compare equal work.
"""

from __future__ import annotations

import copy
import math
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.distributions import Normal
from torch.nn import functional


class PlainActor(nn.Module):
    """Inputs (n, input_dim) to mean and deviation of a Gaussian, (n, action_dim) each."""

    def __init__(
        self,
        input_dim: int,
        action_dim: int,
        hidden: tuple[int, ...],
        log_std_bounds: tuple[float, float],
    ) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for i, o in pairwise((input_dim, *hidden)):
            layers += [nn.Linear(i, o), nn.ReLU()]
        self.trunk = nn.Sequential(*layers)
        self.mean = nn.Linear(hidden[-1], action_dim)
        self.log_std = nn.Linear(hidden[-1], action_dim)
        self.bounds = log_std_bounds

    def sample(self, inputs: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Actions (n, action_dim) and their log densities (n,), from noise (n, action_dim)."""
        h = self.trunk(inputs)
        mean = self.mean(h)
        std = torch.clamp(self.log_std(h), *self.bounds).exp()
        u = mean + std * noise
        log_prob = Normal(mean, std, validate_args=False).log_prob(u).sum(-1)
        # log(1 - tanh(u)^2), without a difference of near equals.
        log_prob = log_prob - (2.0 * (math.log(2.0) - u - functional.softplus(-2.0 * u))).sum(-1)
        return torch.tanh(u), log_prob


def plain_critic(input_dim: int, hidden: tuple[int, ...], layer_norm: bool) -> nn.Sequential:
    """Inputs and actions (n, input_dim) to a value (n, 1)."""
    layers: list[nn.Module] = []
    for i, o in pairwise((input_dim, *hidden)):
        layers.append(nn.Linear(i, o))
        if layer_norm:
            layers.append(nn.LayerNorm(o, elementwise_affine=False))
        layers.append(nn.ReLU())
    return nn.Sequential(*layers, nn.Linear(hidden[-1], 1))


class PlainSac:
    """The learner. `update` takes a batch as tensors.

    Args:
        input_dim, action_dim: Of the networks.
        hidden: Units of the hidden layers.
        layer_norm: Whether the critics normalize them.
        learning_rate: Of all three optimizers.
        polyak: Fraction of the critics that moves into the target critics.
        initial_temperature: Of the entropy bonus.
        target_entropy: Of the policy, nats.
        log_std_bounds: Of the policy's log standard deviation.
        seed: Of the noise.
    """

    def __init__(
        self,
        input_dim: int,
        action_dim: int,
        *,
        hidden: tuple[int, ...],
        layer_norm: bool,
        learning_rate: float,
        polyak: float,
        initial_temperature: float,
        target_entropy: float,
        log_std_bounds: tuple[float, float],
        seed: int,
    ) -> None:
        self.action_dim, self.polyak, self.target_entropy = action_dim, polyak, target_entropy
        self.actor = PlainActor(input_dim, action_dim, hidden, log_std_bounds)
        size = input_dim + action_dim
        self.q1 = plain_critic(size, hidden, layer_norm)
        self.q2 = plain_critic(size, hidden, layer_norm)
        self.q1_target, self.q2_target = copy.deepcopy(self.q1), copy.deepcopy(self.q2)
        self.log_temperature = torch.tensor(math.log(initial_temperature), requires_grad=True)
        self.actor_optimizer = torch.optim.Adam(self.actor.parameters(), lr=learning_rate)
        self.critic_optimizer = torch.optim.Adam(
            [*self.q1.parameters(), *self.q2.parameters()], lr=learning_rate
        )
        self.temperature_optimizer = torch.optim.Adam([self.log_temperature], lr=learning_rate)
        self.generator = torch.Generator().manual_seed(seed)

    def update(
        self,
        inputs: Tensor,
        actions: Tensor,
        returns: Tensor,
        next_inputs: Tensor,
        discounts: Tensor,
    ) -> dict[str, Tensor]:
        """One step of critics, actor, temperature and target critics; its losses.

        Args:
            inputs, next_inputs: Shape (n, input_dim).
            actions: In [-1, 1]. Shape (n, action_dim).
            returns, discounts: Shape (n,).
        """
        temperature = self.log_temperature.exp().detach()
        with torch.no_grad():
            next_actions, log_prob = self.actor.sample(next_inputs, self._noise(len(inputs)))
            x = torch.cat((next_inputs, next_actions), -1)
            value = torch.min(self.q1_target(x), self.q2_target(x)).squeeze(-1)
            target = returns + discounts * (value - temperature * log_prob)

        x = torch.cat((inputs, actions), -1)
        one, two = self.q1(x).squeeze(-1), self.q2(x).squeeze(-1)
        critic_loss = 0.5 * (functional.mse_loss(one, target) + functional.mse_loss(two, target))
        self.critic_optimizer.zero_grad()
        critic_loss.backward()
        self.critic_optimizer.step()

        chosen, log_prob = self.actor.sample(inputs, self._noise(len(inputs)))
        x = torch.cat((inputs, chosen), -1)
        value = torch.min(self.q1(x), self.q2(x)).squeeze(-1)
        actor_loss = (temperature * log_prob - value).mean()
        self.actor_optimizer.zero_grad()
        actor_loss.backward()
        self.actor_optimizer.step()

        wanted = (log_prob.detach() + self.target_entropy).mean()
        temperature_loss = -self.log_temperature * wanted
        self.temperature_optimizer.zero_grad()
        temperature_loss.backward()
        self.temperature_optimizer.step()

        with torch.no_grad():
            for online, slow in ((self.q1, self.q1_target), (self.q2, self.q2_target)):
                for p, t in zip(online.parameters(), slow.parameters(), strict=True):
                    t.mul_(1.0 - self.polyak).add_(self.polyak * p)
        return {"critic_loss": critic_loss.detach(), "actor_loss": actor_loss.detach()}

    def _noise(self, n: int) -> Tensor:
        return torch.randn((n, self.action_dim), generator=self.generator)
