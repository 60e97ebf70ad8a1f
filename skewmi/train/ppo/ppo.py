"""Proximal policy optimization (arXiv:1707.06347) over sequences.

For every step with advantage A, density ratio rho = pi(a | s) / pi_old(a | s) and return R:

    loss = -min(rho A, clip(rho) A) + w_V (V - R)^2 / 2 - w_H H(pi)

Gradients flow back through the memory to the first step of a sequence; the memory before that is
the one that the episode was collected with, a constant.
"""

from __future__ import annotations

import torch
from torch import Tensor

from skewmi.errors import CheckpointError
from skewmi.train.learner import Hidden
from skewmi.train.ppo.config import PpoConfig
from skewmi.train.ppo.networks import ActorCritic, gaussian_entropy, log_density
from skewmi.train.ppo.sequences import Sequences
from skewmi.train.state import State

_ADAM_EPSILON = 1e-5
"""Of the published code: keeps steps small where gradients vanish."""
_TINY = 1e-8


class Ppo:
    """Network, optimizer and one random stream."""

    def __init__(
        self, config: PpoConfig, input_dim: int, action_dim: int, seed: int, device: str = "cpu"
    ) -> None:
        self.config = config
        self.device = torch.device(device)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network = ActorCritic(
                input_dim, action_dim, config.memory, config.heads, config.initial_log_std
            ).to(self.device)
        self._parameters: list[Tensor] = [*self.network.parameters()]
        self.optimizer = torch.optim.Adam(
            self._parameters, lr=config.learning_rate, eps=_ADAM_EPSILON
        )
        # On the CPU wherever the network is, so that a seed draws the same everywhere.
        self.generator = torch.Generator().manual_seed(seed)
        self.updates = 0

    def act(
        self, inputs: Tensor, hidden: Hidden, deterministic: int
    ) -> tuple[Tensor, Tensor, Tensor, Hidden]:
        """One step.

        Args:
            inputs: Shape (n, input_dim).
            hidden: Memory before it.
            deterministic: The first so many rows get the mean action.

        Returns:
            Actions before clipping, shape (n, action_dim); their log densities and the values,
            shape (n,); the next memory.
        """
        with torch.no_grad():
            means, values, after = self.network(inputs[:, None], hidden)
            mean = means[:, 0]
            noise = torch.randn(mean.shape, generator=self.generator).to(self.device)
            noise[:deterministic] = 0.0
            log_std = self.network.log_std
            action = mean + torch.exp(log_std) * noise
            return action, log_density(action, mean, log_std), values[:, 0], after

    def values(self, inputs: Tensor, hidden: Hidden) -> Tensor:
        """Values along sequences. Shape (n, steps)."""
        with torch.no_grad():
            values: Tensor = self.network(inputs, hidden)[1]
            return values

    def loss(self, batch: Sequences) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss of some sequences, and what is worth telling about it."""
        c = self.config
        mean, value, _ = self.network(batch.inputs, batch.hidden)
        log_std = self.network.log_std
        real = batch.real
        # Padding is left out of everything, deviations included.
        old, returns = batch.values[real], batch.returns[real]
        value, advantage = value[real], batch.advantages[real]
        advantage = (advantage - advantage.mean()) / (advantage.std(correction=0) + _TINY)
        log_ratio = (log_density(batch.actions, mean, log_std) - batch.log_density)[real]
        ratio = log_ratio.exp()
        bounded = ratio.clamp(1.0 - c.clip, 1.0 + c.clip)
        policy_loss = -torch.minimum(ratio * advantage, bounded * advantage).mean()
        error = (value - returns).square()
        if c.value_clip is not None:
            near = old + (value - old).clamp(-c.value_clip, c.value_clip)
            error = torch.maximum(error, (near - returns).square())
        value_loss = 0.5 * error.mean()
        entropy = gaussian_entropy(log_std)
        loss = policy_loss + c.value_weight * value_loss - c.entropy_weight * entropy
        return loss, {
            "policy_loss": policy_loss.detach(),
            "value_loss": value_loss.detach(),
            "policy_entropy": entropy.detach(),
            "divergence": 0.5 * log_ratio.detach().square().mean(),
            "clipped_fraction": (ratio.detach() - 1.0).abs().gt(c.clip).float().mean(),
        }

    def update(self, batch: Sequences) -> dict[str, float]:
        """All epochs over a batch; means over its gradient updates."""
        c = self.config
        parts = min(c.minibatches, len(batch))
        sums: dict[str, Tensor] = {}
        for _ in range(c.epochs):
            order = torch.randperm(len(batch), generator=self.generator).to(self.device)
            for index in torch.tensor_split(order, parts):
                loss, told = self.loss(batch.pick(index))
                gradients = torch.autograd.grad(loss, self._parameters)
                for parameter, gradient in zip(self._parameters, gradients, strict=True):
                    parameter.grad = gradient
                norm = torch.nn.utils.clip_grad_norm_(self._parameters, c.max_gradient_norm)
                self.optimizer.step()
                self.updates += 1
                for name, value in {**told, "gradient_norm": norm}.items():
                    sums[name] = sums[name] + value if name in sums else value
        return {name: float(value) / (c.epochs * parts) for name, value in sums.items()}

    def state_dict(self) -> State:
        """Everything that an identical continuation needs, by name."""
        moments = self.optimizer.state_dict()["state"]
        return {
            "network": self.network.state_dict(),
            "optimizer": {str(index): dict(entry) for index, entry in moments.items()},
            "generator": self.generator.get_state(),
            "updates": self.updates,
        }

    def load_state_dict(self, state: State) -> None:
        """Inverse of `state_dict`.

        Raises:
            CheckpointError: Names or shapes do not fit this network.
        """
        try:
            self.network.load_state_dict(state["network"])
            moments = {int(index): dict(entry) for index, entry in state["optimizer"].items()}
            self.optimizer.load_state_dict({**self.optimizer.state_dict(), "state": moments})
            self.generator.set_state(state["generator"].cpu())
            self.updates = int(state["updates"])
        except (KeyError, RuntimeError, ValueError) as error:
            raise CheckpointError(f"the weights do not fit this network: {error}") from error
