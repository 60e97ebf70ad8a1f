"""One whole update of soft actor-critic as one graph of CUDA kernels.

On a GPU these networks are so small that starting a kernel takes longer than the kernel. A CUDA
graph starts all of an update's with one call. It has the same operations as `CompiledUpdate`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, cast

import torch
from torch import Tensor

from skewmi.train.sac.update_function import Tensors, named_scalars, state_of, whole_update

if TYPE_CHECKING:
    from skewmi.train.sac.sac import Batch, Sac

WARM_UPS = 3
"""Updates before the capture, taken back again: libraries choose their kernels and workspaces."""


def can_capture(device: torch.device) -> bool:
    """Whether an update can be captured for a device here: a CUDA GPU's."""
    return device.type == "cuda" and torch.cuda.is_available()


class CapturedUpdate:
    """`Sac.update`, captured at the first call and replayed from then on.

    Args:
        sac: Whose networks, moments and temperature are updated in place. Its optimizers must have
            made a step, so that their moments exist.
        backend: Of `torch.compile`, which then fuses kernels before the capture; None: as they
            are, what training takes.
    """

    def __init__(self, sac: Sac, backend: str | None = None) -> None:
        self._state, self._steps = state_of(sac)
        function = whole_update(sac)
        if backend is not None:
            function = cast(Any, torch.compile(function, fullgraph=True, backend=backend))
        self._function: Callable[..., Tensor] = function
        self._graph: torch.cuda.CUDAGraph | None = None
        self._given: Tensors = []
        self._scalars = torch.empty(0)

    def __call__(self, batch: Batch, target_noise: Tensor, noise: Tensor) -> dict[str, Tensor]:
        """Update with a batch, see `Sac.update`.

        Args:
            batch: Transitions; as many as in the first call, or it is captured anew.
            target_noise, noise: Standard normal, of the next actions and of the actor's. Shape
                (n, action_dim).
        """
        given = [batch.inputs, batch.actions, batch.returns, batch.next_inputs, batch.discounts]
        given += [target_noise, noise]
        if self._graph is None or self._given[0].shape != given[0].shape:
            self._graph = self._captured(given)
        torch._foreach_copy_(self._given, given)
        self._graph.replay()
        # The next replay writes over what this one says.
        return named_scalars(self._scalars.clone())

    def _captured(self, given: Tensors) -> torch.cuda.CUDAGraph:
        """The graph of an update that reads its batch from `_given`; the state stays as it is."""
        self._given = [tensor.clone() for tensor in given]
        changed = [*self._steps, *(tensor for group in self._state for tensor in group)]
        before = [tensor.clone() for tensor in changed]
        stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            for _ in range(WARM_UPS):
                self._update()
        torch.cuda.current_stream().wait_stream(stream)
        torch._foreach_copy_(changed, before)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._scalars = self._update()
        return graph

    @torch.no_grad()
    def _update(self) -> Tensor:
        torch._foreach_add_(self._steps, 1.0)
        *batch, target_noise, noise = self._given
        return self._function(self._state, self._steps[0], tuple(batch), target_noise, noise)
