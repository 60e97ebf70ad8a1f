"""What `export` asks of a policy; `train.policy.TorchPolicy` is one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

from skewmi.policy_io import Array, PolicyLayout

if TYPE_CHECKING:
    import torch


class ExportablePolicy(Protocol):
    """A trained, deterministic policy whose whole computation is one torch module.

    `module(observation)` takes float32 of shape (n, observation_dim) in raw units, and returns
    actions in [-1, 1] of shape (n, action_dim): normalizer, goal, squashing and scale
    are inside. A recurrent module is called as `module(observation, h, c)` with two states of
    shape (n, hidden size), and returns `(action, h_next, c_next)`; it says so with an attribute
    `state_sizes = (size of h, size of c)`.
    """

    layout: PolicyLayout

    @property
    def module(self) -> torch.nn.Module:
        """See the class."""

    @property
    def metadata(self) -> Mapping[str, Any]:
        """What the run knows about itself, JSON-serialisable: method, seed, metrics, ..."""

    def reset(self) -> None:
        """Forget the previous episode."""

    def act(self, observation: Array) -> Array:
        """Shape (..., observation_dim) -> (..., action_dim)."""
