"""How an update is computed: which engine there is where, and who makes it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import torch
from torch import Tensor

from skewmi.errors import CheckpointError, ConfigurationError
from skewmi.train.sac.captured import CapturedUpdate, can_capture
from skewmi.train.sac.compiled import CompiledUpdate, can_compile

if TYPE_CHECKING:
    from skewmi.train.sac.sac import Batch, Sac


class WholeUpdate(Protocol):
    """An update that is computed as a whole."""

    def __call__(self, batch: Batch, target_noise: Tensor, noise: Tensor) -> dict[str, Tensor]:
        """Update in place with a batch and standard normal samples, see `Sac.update`."""
        ...


def chosen_engine(engine: str, device: torch.device) -> str:
    """`eager`, `compiled` or `captured`, for what a configuration says.

    Raises:
        ConfigurationError: One is asked for where it cannot be had.
    """
    if engine == "auto":
        if can_capture(device):
            return "captured"
        return "compiled" if can_compile(device) else "eager"
    if engine == "compiled" and not can_compile(device):
        raise ConfigurationError(
            "learner.engine is 'compiled', which needs a C++ compiler (g++, or what CXX names), "
            f"Python's headers (python3-dev) and the device cpu, here {device.type}; 'eager' works "
            "everywhere"
        )
    if engine == "captured" and not can_capture(device):
        raise ConfigurationError(
            f"learner.engine is 'captured', which needs the device cuda, here {device.type}; "
            "'eager' works everywhere"
        )
    return engine


def kept_engine(engine: str, device: torch.device) -> str:
    """The engine that a run goes on with.

    Args:
        engine: That its checkpoint names.
        device: Where it goes on.

    Raises:
        CheckpointError: It cannot be had here.
    """
    another = "or begin another run with its networks, --start-from RUN --learner.engine eager"
    if engine == "compiled" and not can_compile(device):
        raise CheckpointError(
            "the run's updates were compiled, and there is no C++ compiler here: install one (g++ "
            f"and python3-dev), {another}"
        )
    if engine == "captured" and not can_capture(device):
        raise CheckpointError(
            "the run's updates were captured on a GPU, and it goes on without one: go on where "
            f"there is one, {another}"
        )
    return engine


def make_whole_update(sac: Sac) -> WholeUpdate:
    """What computes the updates of a learner whose engine is not `eager`."""
    return CapturedUpdate(sac) if sac.engine == "captured" else CompiledUpdate(sac)
