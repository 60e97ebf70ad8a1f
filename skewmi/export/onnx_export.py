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

import hashlib
import importlib.metadata
import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from numpy.typing import NDArray

import skewmi
from skewmi import policy_file
from skewmi.errors import PolicyFileError, VerificationError
from skewmi.export.exportable import ExportablePolicy
from skewmi.export.onnx_graph import build_model
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
    layout = policy.layout
    observations = _episodes(observations, layout)
    count = observations.shape[0] * observations.shape[1]
    document = {**policy.metadata, **(metadata or {}), **_layout_metadata(layout)}
    document.pop(policy_file.MEMORY_KEY, None)
    document |= _memory_metadata(policy.module)
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


def _episodes(observations: Array, layout: PolicyLayout) -> Array:
    """Observations to verify with, shape (n_steps, n, observation_dim); at least one."""
    episodes = np.asarray(observations, dtype=np.float64)
    if episodes.ndim == 2:
        episodes = episodes[None]
    if episodes.ndim != 3 or episodes.shape[2] != layout.observation_dim:
        raise PolicyFileError(
            f"observations to verify with have shape {episodes.shape}; task "
            f"{layout.task!r} needs (n_steps, n, {layout.observation_dim})"
        )
    if episodes.size == 0:
        raise PolicyFileError("an export is verified over observations; none were given")
    return episodes


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


def _memory_metadata(module: torch.nn.Module) -> dict[str, Any]:
    """What a recurrent policy remembers; empty for one without a memory."""
    sizes = tuple(int(size) for size in getattr(module, "state_sizes", ()))
    if not sizes:
        return {}
    named = dict(zip(policy_file.STATE_INPUTS, sizes, strict=True))
    return {policy_file.MEMORY_KEY: policy_file.memory_document(named)}


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file so that it has either its former content or all of the new one.

    Raises:
        OutputError: The directory or file cannot be written.
    """
    make_folder(path.parent)
    with written_aside(path) as draft:
        draft.write_bytes(data)
