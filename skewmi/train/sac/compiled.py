"""One whole update of soft actor-critic as one compiled function.

At the sizes used here most of an update's time goes into calling some hundred small operations.
Compiling the losses alone does not help: gradients, optimizer and target critics have as many. So
all of it is one function of tensors, which torch's inductor turns into one call of C++ code. It
computes what `Sac.update` does, in another order of roundings.
"""

from __future__ import annotations

import sysconfig
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import torch
from torch import Tensor

from skewmi.errors import ConfigurationError
from skewmi.matrix_kernels import compiler
from skewmi.train.sac.update_function import named_scalars, state_of, whole_update

if TYPE_CHECKING:
    from skewmi.train.sac.sac import Batch, Sac


def can_compile(device: torch.device) -> bool:
    """Whether torch can compile for a device here: with a C++ compiler and Python's headers."""
    if device.type != "cpu" or compiler() is None:
        return False
    return has_headers()


def has_headers() -> bool:
    """Whether Python's headers are installed, which compiled code includes."""
    return (Path(sysconfig.get_path("include")) / "Python.h").is_file()


class CompiledUpdate:
    """`Sac.update`, compiled at the first call.

    Args:
        sac: Whose networks, moments and temperature are updated in place. Its optimizers must have
            made a step, so that their moments exist.
        backend: Of `torch.compile`; tests take another one than inductor, which needs a minute.
    """

    def __init__(self, sac: Sac, backend: str = "inductor") -> None:
        self._state, self._steps = state_of(sac)
        options: dict[str, Any] = {}
        if backend == "inductor":
            import torch._inductor.config as inductor

            # Or it keeps processes of its own for as long as this one lives.
            inductor.compile_threads = 1
            threads = torch.get_num_threads()
            options["options"] = {"cpp_wrapper": True, "cpp.threads": threads}
        self._update: Callable[..., Tensor] = cast(
            Any, torch.compile(whole_update(sac), fullgraph=True, backend=backend, **options)
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
        return named_scalars(scalars)
