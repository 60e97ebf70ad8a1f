"""A policy file on the robot's computer: onnxruntime and numpy, neither torch nor onnx."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from skewmi import policies, policy_file
from skewmi.errors import LayoutMismatchError, PolicyFileError, did_you_mean
from skewmi.policy_io import Array, PolicyLayout

MAX_FILE_BYTES = 256 * 2**20
"""Refused above this; our policies have 0.1 to 2 MB. Keeps a wrong path from filling memory."""

_PROBES = 16
_SUPPRESS_LOG = 4  # onnxruntime's severity "fatal": errors reach us as exceptions


class OnnxPolicy:
    """A verified policy file; satisfies `policy_io.Policy`.

    One observation takes about 15 us. Not to be used by several threads at once: a recurrent
    policy keeps its state between calls.
    """

    def __init__(
        self, session: Any, layout: PolicyLayout, metadata: Mapping[str, Any], name: str
    ) -> None:
        """Use `load`."""
        self.layout = layout
        self.metadata = dict(metadata)
        """The file's metadata, decoded: task, method, seed, training metrics, limits, ..."""
        self.name = name
        self._session = session
        self._run = session.run
        self._state_sizes = tuple(
            int(value.shape[1])
            for value in session.get_inputs()
            if value.name in policy_file.STATE_INPUTS
        )
        self._outputs = [policy_file.ACTION]
        if self._state_sizes:
            self._outputs += policy_file.STATE_OUTPUTS
        self._state: list[NDArray[np.float32]] = []

    @staticmethod
    def load(path: Path | str) -> OnnxPolicy:
        """Read and check a policy file.

        Args:
            path: Written by `skewmi export-onnx`, or the name of a bundled policy.

        Raises:
            PolicyFileError: The file is missing, damaged, not a policy of this format, or its
                outputs are not finite actions in [-1, 1].
            LayoutMismatchError: Its parts contradict each other: layout and hash, or layout
                and the graph's shapes.
        """
        path = policies.locate(path)
        data = _read(path)
        # First of all, so that no damaged byte ever reaches a parser.
        policy_file.check_seal(data, str(path))
        options = onnxruntime.SessionOptions()
        # One thread: the graph is tiny, and waking a pool costs more than computing it.
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
        options.log_severity_level = _SUPPRESS_LOG
        try:
            session = onnxruntime.InferenceSession(
                data, options, providers=["CPUExecutionProvider"]
            )
        # onnxruntime raises a dozen unrelated classes of its C++ side, whatever the damage.
        except Exception as error:
            reason = " ".join(str(error).split())[:200]
            raise PolicyFileError(f"{path} is not a readable ONNX model: {reason}") from error
        texts = session.get_modelmeta().custom_metadata_map
        metadata = policy_file.decode_metadata(texts, str(path))
        try:
            layout = PolicyLayout.from_json(texts[policy_file.LAYOUT_KEY])
        except LayoutMismatchError as error:
            raise LayoutMismatchError(f"{path}: {error}") from error
        if layout.hash() != metadata[policy_file.LAYOUT_HASH_KEY]:
            raise LayoutMismatchError(
                f"{path}: its layout has hash {layout.hash()[:12]}, its metadata say "
                f"{str(metadata[policy_file.LAYOUT_HASH_KEY])[:12]}; export the policy again"
            )
        _check_signature(session, layout, str(path))
        _check_memory(session, metadata, str(path))
        policy = OnnxPolicy(session, layout, metadata, str(path))
        policy._probe()
        return policy

    @property
    def recurrent(self) -> bool:
        """Whether the action depends on earlier observations since `reset`."""
        return bool(self._state_sizes)

    def reset(self) -> None:
        """Forget the previous episode."""
        self._state = []

    def act(self, observation: Array) -> Array:
        """Action in [-1, 1] for an observation in raw units.

        A recurrent policy advances its state; between two resets, the batch may not change.

        Args:
            observation: Shape (..., observation_dim), layout order.

        Returns:
            Shape (..., action_dim), float64.

        Raises:
            LayoutMismatchError: The width or, since the last reset, the batch is another; or a
                value is not finite. (A graph may turn NaN into an innocent number, so the input
                is what has to be checked.)
        """
        given = np.asarray(observation, dtype=np.float32)
        dim = self.layout.observation_dim
        if given.ndim == 0 or given.shape[-1] != dim:
            raise LayoutMismatchError(
                f"{self.name} takes observations of {dim} numbers "
                f"({', '.join(self.layout.observation_names)}), got shape {given.shape}"
            )
        if not np.isfinite(given).all():
            finite = np.isfinite(given.reshape(-1, dim))
            names = self.layout.observation_names
            bad = [name for name, column in zip(names, finite.T, strict=True) if not column.all()]
            raise LayoutMismatchError(f"observation is not finite in {', '.join(bad)}")
        feed = {policy_file.OBSERVATION: given.reshape(-1, dim)}
        if self._state_sizes:
            batch = feed[policy_file.OBSERVATION].shape[0]
            if not self._state:
                self._state = [np.zeros((batch, n), np.float32) for n in self._state_sizes]
            if len(self._state[0]) != batch:
                raise LayoutMismatchError(
                    f"{self.name} remembers {len(self._state[0])} episodes and got {batch} "
                    "observations; reset it before others begin"
                )
            feed |= zip(policy_file.STATE_INPUTS, self._state, strict=True)
        action, *self._state = self._run(self._outputs, feed)
        result: Array = action.reshape(*given.shape[:-1], action.shape[-1]).astype(np.float64)
        return result

    def _probe(self) -> None:
        """Refuse a graph that gives no usable actions over and beyond the nominal range."""
        low, high = self.layout.observation_low, self.layout.observation_high
        generator = np.random.default_rng(0)
        span = np.where(np.isfinite(high - low), high - low, 1.0)
        points = low + span * generator.uniform(-1.0, 2.0, (_PROBES, low.size))
        try:
            action = self.act(np.where(np.isfinite(points), points, 0.0))
        except LayoutMismatchError:
            raise
        except Exception as error:  # as in load
            reason = " ".join(str(error).split())[:200]
            raise PolicyFileError(f"{self.name} cannot be run: {reason}") from error
        self.reset()
        if action.shape != (_PROBES, self.layout.action_dim):
            raise LayoutMismatchError(
                f"{self.name} gives actions of shape {action.shape} for {_PROBES} observations, "
                f"its layout says {self.layout.action_dim} numbers each"
            )
        if not np.isfinite(action).all():
            raise PolicyFileError(f"{self.name} gives actions that are not finite")
        if np.abs(action).max() > 1.0:
            raise PolicyFileError(
                f"{self.name} gives actions up to {np.abs(action).max():.4g}; allowed is [-1, 1]"
            )


def _read(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise PolicyFileError(
                f"{path} has {size / 2**20:.0f} MiB; a policy file has at most "
                f"{MAX_FILE_BYTES / 2**20:.0f} MiB"
            )
        return path.read_bytes()
    except OSError as error:
        reason = error.strerror or error
        names = policies.bundled()
        raise PolicyFileError(
            f"cannot read the policy file {path}: {reason}; bundled policies are "
            f"{', '.join(names) or 'none'}{did_you_mean(str(path), names)}"
        ) from error


def _check_signature(session: Any, layout: PolicyLayout, name: str) -> None:
    """Compare names, types and widths of the graph with the layout."""
    inputs = {value.name: value for value in session.get_inputs()}
    outputs = {value.name: value for value in session.get_outputs()}
    recurrent = len(inputs) > 1
    expected_inputs = {policy_file.OBSERVATION, *(policy_file.STATE_INPUTS if recurrent else ())}
    expected_outputs = {policy_file.ACTION, *(policy_file.STATE_OUTPUTS if recurrent else ())}
    if set(inputs) != expected_inputs or set(outputs) != expected_outputs:
        raise PolicyFileError(
            f"{name} maps {sorted(inputs)} to {sorted(outputs)}; "
            f"a policy maps {sorted(expected_inputs)} to {sorted(expected_outputs)}"
        )
    wanted = {
        policy_file.OBSERVATION: layout.observation_dim,
        policy_file.ACTION: layout.action_dim,
    }
    for value in (*inputs.values(), *outputs.values()):
        width = value.shape[1] if len(value.shape) == 2 else None
        if value.type != "tensor(float)" or not isinstance(width, int):
            raise PolicyFileError(
                f"{name}: {value.name} is {value.type} of shape {value.shape}; "
                "a policy has float32 of shape (batch, width)"
            )
        if value.name in wanted and width != wanted[value.name]:
            raise LayoutMismatchError(
                f"{name}: {value.name} has {width} numbers, its layout {wanted[value.name]}"
            )


def _check_memory(session: Any, metadata: Mapping[str, Any], name: str) -> None:
    """Compare what the graph remembers with what it hands on, and with what the file says of it.

    Raises:
        LayoutMismatchError: They differ. Files of an earlier skewmi say nothing.
    """
    values = (*session.get_inputs(), *session.get_outputs())
    width = {value.name: value.shape[1] for value in values}
    for before, after in zip(policy_file.STATE_INPUTS, policy_file.STATE_OUTPUTS, strict=True):
        if width.get(before) != width.get(after):
            raise LayoutMismatchError(
                f"{name}: the memory {before} has {width[before]} numbers, "
                f"but what follows it, {after}, has {width[after]}"
            )
    sizes = {key: width[key] for key in policy_file.STATE_INPUTS if key in width}
    described = metadata.get(policy_file.MEMORY_KEY)
    if described is not None and described != policy_file.memory_document(sizes):
        raise LayoutMismatchError(
            f"{name}: its graph remembers {sizes or 'nothing'}, its metadata say {described}; "
            "export the policy again"
        )
