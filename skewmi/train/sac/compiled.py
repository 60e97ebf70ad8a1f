"""One whole update of soft actor-critic as one compiled function.

At the sizes used here most of an update's time goes into calling some hundred small operations.
Compiling the losses alone does not help: gradients, optimizer and target critics have as many. So
all of it is one function of tensors, which torch's inductor turns into one call of C++ code. It
computes what `Sac.update` does, in another order of roundings.
"""

from __future__ import annotations

import os
import shutil
import sysconfig
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import torch
from torch import Tensor
from torch.func import functional_call, grad

from skewmi.errors import ConfigurationError
from skewmi.train.sac.networks import squashed_sample

if TYPE_CHECKING:
    from skewmi.train.sac.sac import Batch, Sac

Tensors = list[Tensor]

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-8
"""Of Adam: torch's defaults, which `Sac`'s optimizers have."""


def can_compile(device: torch.device) -> bool:
    """Whether torch can compile for a device here: with a C++ compiler and Python's headers.

    The compiler is the one that torch takes: what CXX names, else g++.
    """
    if device.type != "cpu" or not shutil.which(os.environ.get("CXX", "g++")):
        return False
    return has_headers()


def has_headers() -> bool:
    """Whether Python's headers are installed, which compiled code includes."""
    return (Path(sysconfig.get_path("include")) / "Python.h").is_file()


def chosen_engine(engine: str, device: torch.device) -> str:
    """`eager` or `compiled`, for what a configuration says.

    Raises:
        ConfigurationError: `compiled` is asked for where it cannot be had.
    """
    if engine == "compiled" and not can_compile(device):
        raise ConfigurationError(
            "learner.engine is 'compiled', which needs a C++ compiler (g++, or what CXX names), "
            f"Python's headers (python3-dev) and the device cpu, here {device.type}; 'eager' works "
            "everywhere"
        )
    if engine == "auto":
        return "compiled" if can_compile(device) else "eager"
    return engine


class CompiledUpdate:
    """`Sac.update`, compiled at the first call.

    Args:
        sac: Whose networks, moments and temperature are updated in place. Its optimizers must have
            made a step, so that their moments exist.
        backend: Of `torch.compile`; tests take another one than inductor, which needs a minute.
    """

    def __init__(self, sac: Sac, backend: str = "inductor") -> None:
        actor = [*sac.actor.parameters(), sac.log_temperature]
        critics, target = [*sac.critics.parameters()], [*sac.target.parameters()]
        a, c = sac.actor_optimizer.state, sac.critic_optimizer.state
        # Without their gradients, which the function asks for itself: parameters cost a guard each.
        self._state: list[Tensors] = [
            [p.detach() for p in actor],
            [a[p]["exp_avg"] for p in actor],
            [a[p]["exp_avg_sq"] for p in actor],
            [p.detach() for p in critics],
            [c[p]["exp_avg"] for p in critics],
            [c[p]["exp_avg_sq"] for p in critics],
            [p.detach() for p in target],
        ]
        self._steps: Tensors = [a[p]["step"] for p in actor] + [c[p]["step"] for p in critics]
        options: dict[str, Any] = {}
        if backend == "inductor":
            import torch._inductor.config as inductor

            # Or it keeps processes of its own for as long as this one lives.
            inductor.compile_threads = 1
            threads = torch.get_num_threads()
            options["options"] = {"cpp_wrapper": True, "cpp.threads": threads}
        self._update: Callable[..., Tensor] = cast(
            Any, torch.compile(_whole_update(sac), fullgraph=True, backend=backend, **options)
        )

    def __call__(self, batch: Batch, target_noise: Tensor, noise: Tensor) -> dict[str, Tensor]:
        """Update with a batch, see `Sac.update`.

        Args:
            batch: Transitions.
            target_noise, noise: Standard normal, of the next actions and of the actor's. Shape
                (n, action_dim).

        Raises:
            ConfigurationError: The compiler failed.
        """
        torch._foreach_add_(self._steps, 1.0)
        given = batch.inputs, batch.actions, batch.returns, batch.next_inputs, batch.discounts
        with torch.no_grad():
            try:
                scalars = self._update(self._state, self._steps[0], given, target_noise, noise)
            except RuntimeError as error:  # all that torch raises of compiling is one
                words = (str(error).strip().splitlines() or ["no reason given"])[0]
                raise ConfigurationError(
                    f"the updates could not be compiled ({words}); begin another run with what "
                    "there is: --start-from RUN --learner.engine eager"
                ) from error
        names = ("critic_loss", "actor_loss", "policy_entropy", "temperature", "value")
        return dict(zip(names, scalars.unbind(), strict=True))


def _whole_update(sac: Sac) -> Callable[..., Tensor]:
    """The function that is compiled; of the networks it uses the structure alone.

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
