"""What differs from episode to episode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array, PolicyLayout


@dataclass(frozen=True)
class Randomization:
    """Ranges of everything that is drawn anew at each reset."""

    start_offset: tuple[float, float, float] = (0.005, 0.005, 0.005)
    """Half-width of the uniform offset of the hand's start from the layout's, m per world axis.
    Starts are clipped to the workspace box. Zeros give identical starts."""

    def __post_init__(self) -> None:
        if len(self.start_offset) != 3 or not all(0.0 <= x <= 0.05 for x in self.start_offset):
            raise ConfigurationError(
                f"start_offset is {self.start_offset}; it must be three half-widths in 0..0.05 m"
            )

    def sample_starts(self, layout: PolicyLayout, num_envs: int, rng: np.random.Generator) -> Array:
        """Start positions of the hand, world, m. Shape (num_envs, 3)."""
        workspace = layout.workspace
        assert workspace is not None
        offset = rng.uniform(-1.0, 1.0, (num_envs, 3)) * np.array(self.start_offset)
        starts: Array = np.clip(np.array(workspace.start) + offset, workspace.low, workspace.high)
        return starts
