"""The state of everything that changes during a run: nested dictionaries of plain values.

Whatever changes has `state_dict()` and `load_state_dict(state)`, as in torch: all that an
identical continuation needs, by name. Leaves are tensors, numpy arrays, or what JSON holds.
`split` parts them for the two files of a checkpoint, `merge` puts them together again.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from skewmi.policy_io import Array

State = dict[str, Any]
"""Name -> tensor, array, JSON value or another `State`."""

_SEPARATOR = "/"
"""Between the names of a path; torch's own names have dots."""


def split(state: State) -> tuple[dict[str, Tensor], State]:
    """Part a state into its tensors, by path, and the rest.

    Args:
        state: Nested; no "/" in the names of tensors and of what holds them.

    Returns:
        Tensors and arrays (as tensors) by path, sharing memory, and the same nesting without
        them, which is what JSON holds.
    """
    tensors: dict[str, Tensor] = {}
    rest: State = {}
    for name, value in state.items():
        found: dict[str, Tensor] = {}
        if isinstance(value, Tensor | np.ndarray):
            found[name] = torch.as_tensor(value)
        elif isinstance(value, dict):
            inner, rest[name] = split(value)
            found = {f"{name}{_SEPARATOR}{path}": tensor for path, tensor in inner.items()}
        else:
            rest[name] = value
        assert not found or _SEPARATOR not in name, name
        tensors |= found
    return tensors, rest


def merge(tensors: dict[str, Tensor], rest: State) -> State:
    """Inverse of `split`, but that arrays come back as tensors."""
    state = {name: merge({}, v) if isinstance(v, dict) else v for name, v in rest.items()}
    for path, tensor in tensors.items():
        *folders, name = path.split(_SEPARATOR)
        place = state
        for folder in folders:
            place = place.setdefault(folder, {})
        place[name] = tensor
    return state


def as_array(value: Tensor | Array) -> Array:
    """An array of its own from a leaf, whether it comes from a file or from memory."""
    return np.array(value.cpu().numpy() if isinstance(value, Tensor) else value)
