"""A policy module as an ONNX graph, as torch's exporter writes it."""

from __future__ import annotations

import contextlib
import copy
import io
import logging
import warnings
from collections.abc import Iterator

import onnx
import torch
from torch import Tensor

import skewmi
from skewmi import policy_file
from skewmi.errors import PolicyFileError
from skewmi.policy_io import PolicyLayout


class Clamped(torch.nn.Module):
    """A policy whose actions are in [-1, 1] to the last bit: a runtime's tanh may pass 1 by one."""

    def __init__(self, module: torch.nn.Module) -> None:
        super().__init__()
        self.module = module

    def forward(self, observation: Tensor, *state: Tensor) -> Tensor | tuple[Tensor, ...]:
        """Same shapes as the policy's."""
        result = self.module(observation, *state)
        if not state:
            return torch.clamp(result, -1.0, 1.0)
        action, *after = result
        return torch.clamp(action, -1.0, 1.0), *after


def build_model(module: torch.nn.Module, layout: PolicyLayout) -> onnx.ModelProto:
    """The ONNX graph of a policy module, without metadata.

    Args:
        module: As `ExportablePolicy.module`.
        layout: Gives the width of the input.

    Raises:
        PolicyFileError: torch cannot express the module in ONNX.
    """
    module = copy.deepcopy(module).to(device="cpu", dtype=torch.float32).eval()
    state_sizes = tuple(int(size) for size in getattr(module, "state_sizes", ()))
    module = Clamped(module)
    inputs = [policy_file.OBSERVATION]
    outputs = [policy_file.ACTION]
    if state_sizes:
        inputs += policy_file.STATE_INPUTS
        outputs += policy_file.STATE_OUTPUTS
    # Two rows: the exporter takes a dimension of size one as constant.
    example = tuple(torch.zeros(2, width) for width in (layout.observation_dim, *state_sizes))
    rows = {0: torch.export.Dim("batch")}
    shapes = (rows, tuple(rows for _ in state_sizes)) if state_sizes else (rows,)
    try:
        with _quiet_torch():
            program = torch.onnx.export(
                module,
                example,
                input_names=inputs,
                output_names=outputs,
                dynamic_shapes=shapes,
                dynamo=True,
                verbose=False,
            )
    # The exporter wraps anything a module may do wrong in classes of its own private modules.
    except Exception as error:
        reason = " ".join(str(error).split())[:300]
        raise PolicyFileError(f"torch cannot write this policy as ONNX: {reason}") from error
    assert program is not None
    model = program.model_proto
    _forget_origin(model)
    model.producer_name = "skewmi"
    model.producer_version = skewmi.__version__
    fields = ", ".join(f"{field.name} [{field.unit}]" for field in layout.observation)
    actions = ", ".join(f"{field.name} [{field.scale:g} {field.unit}]" for field in layout.action)
    model.doc_string = f"Policy of task {layout.task}: observation ({fields}) -> action ({actions})"
    onnx.checker.check_model(model, full_check=True)
    return model


def _forget_origin(model: onnx.ModelProto) -> None:
    """Drop the exporter's notes: stack traces, which name source files of this machine."""
    graph = model.graph
    for part in (*graph.node, *graph.input, *graph.output, *graph.value_info, *graph.initializer):
        del part.metadata_props[:]
        part.doc_string = ""
    del graph.metadata_props[:]
    graph.doc_string = ""
    graph.name = "policy"
    del model.metadata_props[:]


@contextlib.contextmanager
def _quiet_torch() -> Iterator[None]:
    """Silence notes of torch's exporter on packages we do not use."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
