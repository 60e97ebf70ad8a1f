"""Random transitions for tests of soft actor-critic."""

from __future__ import annotations

import torch

from skewmi.train.sac.sac import Batch


def batches(count: int, n: int = 32) -> list[Batch]:
    """Batches of n transitions, 5 inputs and 2 actions; the same at every call."""
    g = torch.Generator().manual_seed(5)
    return [
        Batch(
            torch.randn(n, 5, generator=g),
            2 * torch.rand(n, 2, generator=g) - 1,
            torch.randn(n, generator=g),
            torch.randn(n, 5, generator=g),
            0.9 * torch.rand(n, generator=g),
        )
        for _ in range(count)
    ]
