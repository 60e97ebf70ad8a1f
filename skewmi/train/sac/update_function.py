"""An update of soft actor-critic as one function of tensors, for engines that take it whole."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import torch
from torch import Tensor
from torch.func import functional_call, grad

from skewmi.train.sac.networks import squashed_sample

if TYPE_CHECKING:
    from skewmi.train.sac.sac import Sac

Tensors = list[Tensor]

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-8
"""Of Adam: torch's defaults, which `Sac`'s optimizers have."""


def state_of(sac: Sac) -> tuple[list[Tensors], Tensors]:
    """What an update changes in place, as `whole_update` takes it, and Adam's counts of steps.

    Its optimizers must have made a step, so that their moments exist.
    """
    actor = [*sac.actor.parameters(), sac.log_temperature]
    critics, target = [*sac.critics.parameters()], [*sac.target.parameters()]
    a, c = sac.actor_optimizer.state, sac.critic_optimizer.state
    # Without their gradients, which the function asks for itself: parameters cost a guard each.
    state: list[Tensors] = [
        [p.detach() for p in actor],
        [a[p]["exp_avg"] for p in actor],
        [a[p]["exp_avg_sq"] for p in actor],
        [p.detach() for p in critics],
        [c[p]["exp_avg"] for p in critics],
        [c[p]["exp_avg_sq"] for p in critics],
        [p.detach() for p in target],
    ]
    return state, [a[p]["step"] for p in actor] + [c[p]["step"] for p in critics]


def named_scalars(scalars: Tensor) -> dict[str, Tensor]:
    """What an update says of itself, by name, of what `whole_update` returns."""
    names = ("critic_loss", "actor_loss", "policy_entropy", "temperature", "value")
    return dict(zip(names, scalars.unbind(), strict=True))


def whole_update(sac: Sac) -> Callable[..., Tensor]:
    """An update as one function; of the networks it uses the structure alone.

    It changes the state in place: the loop that computes a new value writes it where it belongs.
    """
    config, target_entropy = sac.config, sac.target_entropy
    actor_names = [name for name, _ in sac.actor.named_parameters()]
    critic_names = [name for name, _ in sac.critics.named_parameters()]

    def sample(parameters: Tensors, inputs: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        named = dict(zip(actor_names, parameters, strict=True))
        mean, log_std = functional_call(sac.actor, named, (inputs,))
        return squashed_sample(mean, log_std, noise)

    def values(parameters: Tensors, inputs: Tensor, actions: Tensor) -> Tensor:
        named = dict(zip(critic_names, parameters, strict=True))
        return cast(
            Tensor, functional_call(sac.critics, named, (torch.cat((inputs, actions), -1),))
        )

    def update(
        state: list[Tensors],
        step: Tensor,
        batch: tuple[Tensor, ...],
        target_noise: Tensor,
        noise: Tensor,
    ) -> Tensor:
        own, own_mean, own_square, critics, mean, square, target = state
        actor, log_temperature = own[:-1], own[-1]
        inputs, actions, returns, next_inputs, discounts = batch
        temperature = log_temperature.exp()

        next_actions, log_prob = sample(actor, next_inputs, target_noise)
        value = values(target, next_inputs, next_actions).amin(0) - temperature * log_prob
        wanted = returns + discounts * value

        def critic_loss(parameters: Tensors) -> tuple[Tensor, tuple[Tensor, Tensor]]:
            predicted = values(parameters, inputs, actions)
            loss = 0.5 * (predicted - wanted).square().mean(1).sum()
            return loss, (loss, predicted.mean())

        grads, (loss, predicted) = grad(critic_loss, has_aux=True)(critics)
        critics, mean, square = _adam(critics, grads, mean, square, step, config.learning_rate)

        def actor_loss(parameters: Tensors) -> tuple[Tensor, tuple[Tensor, Tensor]]:
            chosen, log_prob = sample(parameters, inputs, noise)
            loss = (temperature * log_prob - values(critics, inputs, chosen).amin(0)).mean()
            return loss, (loss, -log_prob.mean())

        grads, (own_loss, entropy) = grad(actor_loss, has_aux=True)(actor)
        grads = [*grads, entropy - target_entropy]
        own, own_mean, own_square = _adam(
            own, grads, own_mean, own_square, step, config.learning_rate
        )
        target = [t + config.polyak * (c - t) for t, c in zip(target, critics, strict=True)]
        new = [own, own_mean, own_square, critics, mean, square, target]
        for tensors, results in zip(state, new, strict=True):
            for tensor, result in zip(tensors, results, strict=True):
                tensor.copy_(result)
        return torch.stack((loss, own_loss, entropy, temperature, predicted))

    return update


def _adam(
    parameters: Tensors, grads: Tensors, mean: Tensors, square: Tensors, step: Tensor, rate: float
) -> tuple[Tensors, Tensors, Tensors]:
    """A step of Adam: new parameters and moments."""
    mean = [m + (1.0 - BETA1) * (g - m) for m, g in zip(mean, grads, strict=True)]
    square = [BETA2 * v + (1.0 - BETA2) * g * g for v, g in zip(square, grads, strict=True)]
    size = rate / (1.0 - BETA1**step)
    root = (1.0 - BETA2**step).sqrt()
    stepped = [
        p - size * m / (v.sqrt() / root + EPSILON)
        for p, m, v in zip(parameters, mean, square, strict=True)
    ]
    return stepped, mean, square
