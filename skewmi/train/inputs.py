"""What the networks are fed: observation and reference point, from the layout's ranges."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from skewmi.policy_io import Array, PolicyLayout


class InputMap:
    """Affine map of (observation, reference point) to network inputs.

    With `normalise` every field goes from its nominal range to [-1, 1]; otherwise it stays in
    its unit, as in the published code.
    """

    def __init__(self, layout: PolicyLayout, normalise: bool) -> None:
        low, high = layout.observation_low, layout.observation_high
        centre, half = 0.5 * (low + high), 0.5 * (high - low)
        if not normalise:
            centre, half = np.zeros_like(centre), np.ones_like(half)
        state = slice(0, layout.state_dim)
        self.centre: Array = np.concatenate((centre, centre[state]))
        self.half: Array = np.concatenate((half, half[state]))
        self.dim = len(self.centre)

    def __call__(self, observation: NDArray[np.floating], goal: NDArray[np.floating]) -> Tensor:
        """Inputs of shape (n, observation_dim + state_dim), float32."""
        both = np.concatenate((observation, goal), axis=-1)
        return torch.as_tensor((both - self.centre) / self.half, dtype=torch.float32)
