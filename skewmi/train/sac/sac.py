"""Soft actor-critic with automatic temperature (arXiv:1812.05905), n-step targets.

Targets, for a transition that sums n steps of reward R and then bootstraps with gamma^m:

    y = R + gamma^m (min_i Q'_i(s', a') - temperature * log pi(a' | s')),   a' ~ pi(. | s')

The entropy bonus of the steps inside R is left out, as usual for n-step actor-critics: it
would need the old policy's densities.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from skewmi.errors import CheckpointError
from skewmi.train.sac.config import SacConfig
from skewmi.train.sac.engines import WholeUpdate, chosen_engine, kept_engine, make_whole_update
from skewmi.train.sac.networks import Actor, Critics
from skewmi.train.state import State


@dataclass(frozen=True)
class Batch:
    """Transitions ready for an update; float32 on the learner's device.

    Attributes:
        inputs: Network inputs (observation and goal). Shape (n, input_dim).
        actions: In [-1, 1]. Shape (n, action_dim).
        returns: Discounted reward of up to n_step steps. Shape (n,).
        next_inputs: Inputs after those steps. Shape (n, input_dim).
        discounts: gamma^m, or 0 where nothing follows. Shape (n,).
    """

    inputs: Tensor
    actions: Tensor
    returns: Tensor
    next_inputs: Tensor
    discounts: Tensor

    def __len__(self) -> int:
        return len(self.returns)

    def part(self, start: int, stop: int) -> Batch:
        """Rows start..stop-1, sharing memory."""
        return Batch(
            self.inputs[start:stop],
            self.actions[start:stop],
            self.returns[start:stop],
            self.next_inputs[start:stop],
            self.discounts[start:stop],
        )


class Sac:
    """The learner: networks, optimizers and one random stream."""

    def __init__(
        self, config: SacConfig, input_dim: int, action_dim: int, seed: int, device: str = "cpu"
    ) -> None:
        self.config = config
        self.device = torch.device(device)
        self.action_dim = action_dim
        bounds = (config.log_std_min, config.log_std_max)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.actor = Actor(input_dim, action_dim, config.hidden, bounds).to(self.device)
            size = input_dim + action_dim
            self.critics = Critics(2, size, config.hidden, config.layer_norm).to(self.device)
        self.target = Critics(2, size, config.hidden, config.layer_norm).to(self.device)
        self.target.load_state_dict(self.critics.state_dict())
        self.target.requires_grad_(False)
        # The very actor where nothing is averaged.
        self.steady_actor = self.actor
        if config.actor_average > 0.0:
            self.steady_actor = copy.deepcopy(self.actor).requires_grad_(False)
        self.log_temperature = torch.full((), config.initial_temperature, device=self.device).log_()
        target = config.target_entropy
        self.target_entropy = -float(action_dim) if target is None else target

        self._actor_parameters: list[Tensor] = [*self.actor.parameters()]
        self._steady_parameters: list[Tensor] = [*self.steady_actor.parameters()]
        self._critic_parameters: list[Tensor] = [*self.critics.parameters()]
        self._target_parameters: list[Tensor] = [*self.target.parameters()]
        rate = config.learning_rate
        # The temperature shares the actor's optimizer: one fused call less per update.
        self.actor_optimizer = torch.optim.Adam(
            [*self._actor_parameters, self.log_temperature], lr=rate, fused=True
        )
        self.critic_optimizer = torch.optim.Adam(self._critic_parameters, lr=rate, fused=True)
        self.generator = torch.Generator(self.device).manual_seed(seed)
        self.updates = 0
        self.engine = chosen_engine(config.engine, self.device)
        """`eager`, `compiled` or `captured`: how an update is computed, after the first ones."""
        self._whole: WholeUpdate | None = None

    def act(self, inputs: Tensor, deterministic: bool = False) -> Tensor:
        """Actions for inputs (n, input_dim), deterministic ones by the average of the actor's
        weights if there is one. Shape (n, action_dim)."""
        with torch.no_grad():
            if deterministic:
                mean: Tensor = self.steady_actor(inputs)[0]
                return torch.tanh(mean)
            return self.actor.sample(inputs, self._noise(len(inputs)))[0]

    def _noise(self, n: int) -> Tensor:
        shape = (n, self.action_dim)
        return torch.randn(shape, generator=self.generator, device=self.device)

    def targets(self, batch: Batch) -> Tensor:
        """What the critics are regressed to. Shape (n,)."""
        with torch.no_grad():
            action, log_prob = self.actor.sample(batch.next_inputs, self._noise(len(batch)))
            value: Tensor = self.target(torch.cat((batch.next_inputs, action), -1)).amin(0)
            value = value - self.log_temperature.exp() * log_prob
            return batch.returns + batch.discounts * value

    def update(self, batch: Batch) -> dict[str, Tensor]:
        """One step of critics, actor, temperature and target critics.

        Returns:
            Scalars of this update, still tensors so that nothing waits for the device.

        Raises:
            ConfigurationError: It cannot be compiled here.
        """
        if self.engine != "eager" and self.updates >= self.config.compile_after:
            if self._whole is None:
                self._whole = make_whole_update(self)
            noises = self._noise(len(batch)), self._noise(len(batch))
            scalars = self._whole(batch, *noises)
        else:
            scalars = self._eager_update(batch)
        self.updates += 1
        if self.steady_actor is not self.actor:
            self._average()
        return scalars

    @torch.no_grad()
    def _average(self) -> None:
        """Move the average actor, at first to the mean of all weights so far."""
        part = max(1.0 - self.config.actor_average, 1.0 / self.updates)
        torch._foreach_lerp_(self._steady_parameters, self._actor_parameters, part)

    def _eager_update(self, batch: Batch) -> dict[str, Tensor]:
        """`update`, operation by operation."""
        target = self.targets(batch)
        values = self.critics(torch.cat((batch.inputs, batch.actions), -1))
        critic_loss = 0.5 * (values - target).square().mean(1).sum()
        grads = torch.autograd.grad(critic_loss, self._critic_parameters)
        for parameter, grad in zip(self._critic_parameters, grads, strict=True):
            parameter.grad = grad
        self.critic_optimizer.step()

        temperature = self.log_temperature.exp()
        action, log_prob = self.actor.sample(batch.inputs, self._noise(len(batch)))
        value = self.critics(torch.cat((batch.inputs, action), -1)).amin(0)
        actor_loss = (temperature * log_prob - value).mean()
        # Only the actor's gradients are asked for, so the critics' are never computed.
        grads = torch.autograd.grad(actor_loss, self._actor_parameters)
        for parameter, grad in zip(self._actor_parameters, grads, strict=True):
            parameter.grad = grad
        entropy = -log_prob.detach().mean()
        # d/d log_t of log_t * (entropy - target): warmer when the policy is too certain.
        self.log_temperature.grad = entropy - self.target_entropy
        self.actor_optimizer.step()

        with torch.no_grad():
            torch._foreach_lerp_(
                self._target_parameters, self._critic_parameters, self.config.polyak
            )
        return {
            "critic_loss": critic_loss.detach(),
            "actor_loss": actor_loss.detach(),
            "policy_entropy": entropy,
            "temperature": temperature,
            "value": values.detach().mean(),
        }

    def state_dict(self) -> State:
        """Everything that an identical continuation needs, by name."""
        state: State = {name: module.state_dict() for name, module in self._modules()}
        for name, optimizer in self._optimizers():
            moments = optimizer.state_dict()["state"]
            state[name] = {str(index): dict(entry) for index, entry in moments.items()}
        return {
            **state,
            "log_temperature": self.log_temperature,
            "generator": self.generator.get_state(),
            "updates": self.updates,
            "engine": self.engine,
        }

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`.

        Raises:
            CheckpointError: Names or shapes do not fit these networks, or the updates were
                compiled, and cannot be here.
        """
        if self.config.engine == "auto":
            self.engine = kept_engine(state.get("engine", "eager"), self.device)
        self._whole = None  # It holds the moments that are replaced here.
        try:
            for name, module in self._modules():
                if name == "steady_actor" and name not in state:
                    name = "actor"  # of a run that averaged nothing: the average begins there
                module.load_state_dict(state[name])
            self.log_temperature.copy_(state["log_temperature"])
            self.generator.set_state(state["generator"].cpu())
            self.updates = int(state["updates"])
            for name, optimizer in self._optimizers():
                moments = {int(index): dict(entry) for index, entry in state[name].items()}
                optimizer.load_state_dict({**optimizer.state_dict(), "state": moments})
        except (KeyError, RuntimeError, ValueError) as error:
            raise CheckpointError(f"the weights do not fit these networks: {error}") from error

    def _modules(self) -> tuple[tuple[str, nn.Module], ...]:
        modules: tuple[tuple[str, nn.Module], ...] = (
            ("actor", self.actor),
            ("critics", self.critics),
            ("target", self.target),
        )
        if self.steady_actor is not self.actor:
            modules += (("steady_actor", self.steady_actor),)
        return modules

    def _optimizers(self) -> tuple[tuple[str, torch.optim.Adam], ...]:
        return (
            ("actor_optimizer", self.actor_optimizer),
            ("critic_optimizer", self.critic_optimizer),
        )
