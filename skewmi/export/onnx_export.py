"""Write a trained policy as one self-describing ONNX file, after proving that it is the same.

The input is float32 in raw units. The network computes in float32 anyway; rounding a coordinate
of 1 m to float32 moves it by 60 nm, far below any sensor here; and float64 would cost twice the
time and leave the fast kernels. The normaliser, the chosen reference point, the squashing and
the scale are part of the graph: whoever runs the file passes what `policy_io` assembles and
needs to know nothing else.

Nothing is pickled, and the file depends on the policy only: no time stamps, no paths. The same
checkpoint gives the same bytes.
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
import importlib.metadata
import io
import json
import logging
import platform
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from numpy.typing import NDArray
from torch import Tensor

import skewmi
from skewmi import policy_file
from skewmi.errors import PolicyFileError, VerificationError
from skewmi.export.exportable import ExportablePolicy
from skewmi.outputs import make_folder, written_aside
from skewmi.policy_io import Array, PolicyLayout

TOLERANCE = 1e-5
"""Largest difference between the actions of torch and onnxruntime, per component."""

_SINGLE_ROWS = 64
"""Observations also run alone: batches of one take other kernels, and are what a robot runs."""


@dataclass(frozen=True)
class ExportReport:
    """What was written and how it was verified."""

    path: Path
    size_bytes: int
    sha256: str
    """Of the whole file."""
    layout_hash: str
    observations: int
    """How many observations torch and onnxruntime were compared on."""
    max_difference: float
    """Largest absolute difference of an action component over them."""


def export_policy(
    policy: ExportablePolicy,
    path: Path | str,
    observations: Array,
    *,
    metadata: Mapping[str, Any] | None = None,
) -> ExportReport:
    """Write a policy as ONNX, or refuse and leave `path` as it was.

    Args:
        policy: What to write.
        path: The file; its directory is created.
        observations: Recorded while the policy ran, for the comparison. Shape (n_steps, n,
            observation_dim), n episodes from their start; or (n, observation_dim) for a policy
            without memory.
        metadata: Added to the policy's own, and stronger; JSON-serialisable. Together they
            must have "method" and "robot_model_hash" (None for a task without a robot).

    Raises:
        VerificationError: The graph differs from torch by more than `TOLERANCE`, or weights
            or actions are not finite.
        PolicyFileError: The graph cannot be built, or metadata are missing or not JSON.
        OutputError: The file cannot be written.
    """
    path = Path(path)
    observations = np.asarray(observations, dtype=np.float64)
    if observations.ndim == 2:
        observations = observations[None]
    layout = policy.layout
    if observations.ndim != 3 or observations.shape[2] != layout.observation_dim:
        raise PolicyFileError(
            f"observations to verify with have shape {observations.shape}; task "
            f"{layout.task!r} needs (n_steps, n, {layout.observation_dim})"
        )
    if observations.size == 0:
        raise PolicyFileError("an export is verified over observations; none were given")
    count = observations.shape[0] * observations.shape[1]
    document = {**policy.metadata, **(metadata or {}), **_layout_metadata(layout)}
    missing = [key for key in policy_file.REQUIRED_KEYS if key not in document]
    if missing:
        raise PolicyFileError(f"a policy file needs the metadata {missing}; {path} is not written")
    policy_file.encode_metadata(document)  # what is no JSON is refused before the long part
    _require_finite(policy.module, layout)
    model = build_model(policy.module, layout)
    difference = max_difference(policy, model.SerializeToString(), observations)
    if not difference <= TOLERANCE:  # also when it is NaN
        raise VerificationError(
            f"the ONNX graph of task {layout.task!r} differs from torch by {difference:.3g} over "
            f"{count} observations (allowed {TOLERANCE:g}); {path} is not written"
        )
    document["verification"] = {
        "observations": count,
        "max_difference": difference,
        "tolerance": TOLERANCE,
    }
    for key, text in policy_file.encode_metadata(document).items():
        model.metadata_props.add(key=key, value=text)
    data = policy_file.seal(model.SerializeToString(deterministic=True))
    write_atomically(path, data)
    return ExportReport(
        path=path,
        size_bytes=len(data),
        sha256=hashlib.sha256(data).hexdigest(),
        layout_hash=layout.hash(),
        observations=count,
        max_difference=difference,
    )


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


def max_difference(policy: ExportablePolicy, model: bytes, observations: Array) -> float:
    """Largest difference between the actions of `policy.act` and of a serialised graph.

    Both start from reset and see the same observations; a graph with memory keeps its own.

    Args:
        policy: The reference.
        model: A serialised ONNX model.
        observations: Shape (n_steps, n, observation_dim).

    Returns:
        The largest absolute difference of a component; NaN if an action is not finite.
    """
    alone = observations[:_SINGLE_ROWS, :1]
    differences = [
        np.abs(_torch_actions(policy, given) - _onnx_actions(model, given)).max()
        for given in (observations, alone)
    ]
    return float(np.max(differences))


def _require_finite(module: torch.nn.Module, layout: PolicyLayout) -> None:
    """ReLU and tanh hide an infinite weight from every comparison of outputs."""
    tensors = module.state_dict().items()
    bad = [name for name, value in tensors if not bool(torch.isfinite(value).all())]
    if bad:
        raise VerificationError(
            f"the policy of task {layout.task!r} has weights that are not finite in "
            f"{', '.join(bad[:5])}; nothing is written"
        )


def _torch_actions(policy: ExportablePolicy, observations: Array) -> Array:
    policy.reset()
    actions = np.stack([policy.act(step) for step in observations])
    policy.reset()
    return actions


def _onnx_actions(model: bytes, observations: Array) -> Array:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    n = observations.shape[1]
    state: list[NDArray[np.float32]] = [
        np.zeros((n, value.shape[1]), np.float32)
        for value in session.get_inputs()
        if value.name in policy_file.STATE_INPUTS
    ]
    actions = []
    for step in observations:
        feed = {policy_file.OBSERVATION: step.astype(np.float32)}
        feed |= zip(policy_file.STATE_INPUTS, state, strict=False)
        action, *state = session.run(None, feed)
        actions.append(action.astype(np.float64))
    return np.stack(actions)


def _layout_metadata(layout: PolicyLayout) -> dict[str, Any]:
    """What this module knows better than any run directory."""
    content = json.loads(layout.to_json())
    return {
        policy_file.FORMAT_KEY: policy_file.FORMAT_VERSION,
        policy_file.LAYOUT_KEY: content,
        policy_file.LAYOUT_HASH_KEY: layout.hash(),
        "task": layout.task,
        # Also part of the layout; repeated for people who look at the file in an ONNX viewer.
        "control_dt": layout.control_dt,
        "workspace": content["workspace"],
        "versions": {
            "skewmi": skewmi.__version__,
            "torch": torch.__version__,
            "onnx": onnx.__version__,
            "onnxruntime": onnxruntime.__version__,
            "numpy": np.__version__,
            "mujoco": importlib.metadata.version("mujoco"),
            "python": platform.python_version(),
        },
    }


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


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file so that it has either its former content or all of the new one.

    Raises:
        OutputError: The directory or file cannot be written.
    """
    make_folder(path.parent)
    with written_aside(path) as draft:
        draft.write_bytes(data)
