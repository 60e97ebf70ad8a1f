"""What the networks are fed: observation and goal, from the layout's ranges."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array, PolicyLayout


class InputNormalizer:
    """Affine map of (observation, goal) to network inputs.

    With `normalize` every field goes from its nominal range to [-1, 1]; otherwise it stays in
    its unit, as in the published code.

    Args:
        layout: Of the task.
        goal_dim: Size of a goal: state_dim, or 0 without goals.
        normalize: See above.
    """

    def __init__(self, layout: PolicyLayout, goal_dim: int, *, normalize: bool) -> None:
        if goal_dim not in (0, layout.state_dim):
            raise ConfigurationError(
                f"goals of {goal_dim} numbers; they are states of {layout.state_dim}, or empty"
            )
        low, high = layout.observation_low, layout.observation_high
        center, half = 0.5 * (low + high), 0.5 * (high - low)
        if not normalize:
            center, half = np.zeros_like(center), np.ones_like(half)
        self.observation_dim = layout.observation_dim
        self.center: Array = np.concatenate((center, center[:goal_dim]))
        self.half: Array = np.concatenate((half, half[:goal_dim]))
        self.dim = len(self.center)

    def __call__(self, observation: NDArray[np.floating], goal: NDArray[np.floating]) -> Tensor:
        """Inputs of shape (n, observation_dim + goal_dim), float32."""
        both = np.concatenate((observation, goal), axis=-1)
        return torch.as_tensor((both - self.center) / self.half, dtype=torch.float32)

    def folded(self, goal: Array) -> tuple[Tensor, Tensor, Tensor]:
        """The map with a fixed goal, as constants of an exported policy.

        Divided in float64 here, so that they round once only.

        Args:
            goal: In the task's units. Shape (goal_dim,).

        Returns:
            Center and inverse half-width of the observation, shape (observation_dim,), and the
            goal as the networks see it, shape (goal_dim,); float32.
        """
        n = self.observation_dim
        parts = self.center[:n], 1.0 / self.half[:n], (goal - self.center[n:]) / self.half[n:]
        center, inverse_half, scaled = (torch.as_tensor(x, dtype=torch.float32) for x in parts)
        return center, inverse_half, scaled
