"""A trained policy as anybody else uses it: observation in, action out, nothing else to know."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from skewmi.errors import LayoutMismatchError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.inputs import InputNormalizer
from skewmi.train.sac.networks import Actor


class PolicyModule(nn.Module):
    """Raw observation (n, observation_dim) float32 -> action in [-1, 1] (n, action_dim).

    The input map and the goal are constants of the module, so exporting it exports
    the whole policy. The action is the mode of the squashed policy's Gaussian, tanh(mean).
    """

    def __init__(
        self, actor: Actor, inputs: InputNormalizer, observation_dim: int, goal: Array
    ) -> None:
        super().__init__()
        self.body = actor.body
        self.action_dim = actor.body[-1].out_features // 2  # type: ignore[operator]
        # In float64 here, so that the folded constants round once only.
        n = observation_dim
        reference = (goal - inputs.center[n:]) / inputs.half[n:]
        self.register_buffer("center", _single(inputs.center[:n]))
        self.register_buffer("inverse_half", _single(1.0 / inputs.half[:n]))
        self.register_buffer("reference", _single(reference))

    def forward(self, observation: Tensor) -> Tensor:
        scaled = (observation - self.center) * self.inverse_half  # type: ignore[operator]
        reference: Tensor = self.reference  # type: ignore[assignment]
        whole = torch.cat((scaled, reference.expand(observation.shape[0], -1)), dim=-1)
        mean: Tensor = self.body(whole)[:, : self.action_dim]
        return torch.tanh(mean)


class TorchPolicy:
    """A checkpoint's policy with its goal fixed; satisfies `policy_io.Policy`.

    Attributes:
        layout: What it was trained on.
        module: See `PolicyModule`; what `export` writes.
        goal: The fixed goal, in the task's units. Shape (state_dim,).
        metadata: Task, method, seed, steps and training metrics; JSON-serialisable.
    """

    def __init__(
        self,
        layout: PolicyLayout,
        actor: Actor,
        inputs: InputNormalizer,
        goal: Array,
        metadata: dict[str, Any],
    ) -> None:
        self.layout = layout
        self.goal = goal
        self.metadata = metadata
        self.module = PolicyModule(actor, inputs, layout.observation_dim, goal).eval()
        self.module.requires_grad_(False)

    def reset(self) -> None:
        """Nothing to forget: the policy has no memory."""

    def act(self, observation: Array) -> Array:
        """Action in [-1, 1], shape (..., action_dim), for an observation (..., observation_dim).

        Raises:
            LayoutMismatchError: The last axis has another length.
        """
        observation = np.asarray(observation)
        if observation.shape[-1] != self.layout.observation_dim:
            raise LayoutMismatchError(
                f"observation has {observation.shape[-1]} fields, this policy needs "
                f"{self.layout.observation_dim}: {', '.join(self.layout.observation_names)}"
            )
        flat = _single(observation.reshape(-1, self.layout.observation_dim))
        with torch.no_grad():
            action: Array = self.module(flat).double().numpy()
        return action.reshape(*observation.shape[:-1], -1)


def _single(values: Array) -> Tensor:
    return torch.as_tensor(np.ascontiguousarray(values), dtype=torch.float32)
