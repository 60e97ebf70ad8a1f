"""The format of a policy file: what `export` writes and `deploy` reads, in one place.

A policy file is an ordinary ONNX model, readable by any ONNX tool, with two additions:

* each of its `metadata_props` is a JSON document under one of the keys below (numbers at full
  precision), and
* its last metadata entry is the sha256 of every byte before it. A file that was truncated,
  damaged or edited is therefore refused, instead of moving a robot with other weights.

Repeated fields of protobuf concatenate, so the seal is appended as raw bytes and checked without
a protobuf library: deployment needs neither `onnx` nor `protobuf`.

The seal finds accidents, not forgery: whoever can rewrite the file can seal it again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from skewmi.errors import PolicyFileError

FORMAT_VERSION = 1
"""Raised when a reader of the previous version would misread the file."""

OBSERVATION = "observation"
"""Name of the graph's input, float32, shape (batch, observation_dim), raw units."""
ACTION = "action"
"""Name of the graph's output, float32, shape (batch, action_dim), in [-1, 1]."""
STATE_INPUTS = ("h", "c")
"""Further inputs of a recurrent policy, float32, shape (batch, hidden size); zero at reset."""
STATE_OUTPUTS = ("h_next", "c_next")
"""Further outputs of a recurrent policy: what to pass as `h` and `c` at the next step."""

FORMAT_KEY = "skewmi_policy"
LAYOUT_KEY = "layout"
LAYOUT_HASH_KEY = "layout_hash"
MEMORY_KEY = "memory"
"""Key of what a recurrent policy remembers, see `memory_document`; policies without a memory, and
files of an earlier skewmi, do not have it."""
SEAL_KEY = "content_sha256"
REQUIRED_KEYS = (
    FORMAT_KEY,
    LAYOUT_KEY,
    LAYOUT_HASH_KEY,
    "task",
    "method",
    "robot_model_hash",
    "control_dt",
)


def memory_document(sizes: Mapping[str, int]) -> dict[str, Any]:
    """What whoever runs a recurrent policy needs to know of its memory.

    Args:
        sizes: Of each of `STATE_INPUTS`.
    """
    return {
        "sizes": dict(sizes),
        "next": dict(zip(STATE_INPUTS, STATE_OUTPUTS, strict=True)),
        "type": "float32, shape (batch, size)",
        "initial": "zeros, at the start of every episode; then what the step before gave",
    }


def _protobuf_bytes(field: int, value: bytes) -> bytes:
    """A length-delimited protobuf field; both numbers must fit into seven bits' varints."""
    assert field < 16
    assert len(value) < 128
    return bytes([field << 3 | 2, len(value)]) + value


def _seal_entry(digest: str) -> bytes:
    """`ModelProto.metadata_props` (field 14): a StringStringEntryProto {key = 1, value = 2}."""
    entry = _protobuf_bytes(1, SEAL_KEY.encode())
    entry += _protobuf_bytes(2, json.dumps(digest).encode())
    return _protobuf_bytes(14, entry)


_SEAL_LENGTH = len(_seal_entry("0" * 64))


def seal(model: bytes) -> bytes:
    """Append the sha256 of a serialised ONNX model to it as its last metadata entry."""
    return model + _seal_entry(hashlib.sha256(model).hexdigest())


def check_seal(data: bytes, name: str) -> None:
    """Refuse a policy file whose content is not what was exported.

    Args:
        data: The whole file.
        name: What to call it in the message.

    Raises:
        PolicyFileError: The seal is missing or belongs to other content.
    """
    model, found = data[:-_SEAL_LENGTH], data[-_SEAL_LENGTH:]
    if SEAL_KEY.encode() not in found:
        raise PolicyFileError(
            f"{name} is not a whole policy file of skewmi: it is truncated, edited, or not an ONNX "
            "model that skewmi export-onnx wrote"
        )
    if found != _seal_entry(hashlib.sha256(model).hexdigest()):
        raise PolicyFileError(
            f"{name} is damaged or edited: its content does not match its sha256; export it again"
        )


def encode_metadata(metadata: Mapping[str, Any]) -> dict[str, str]:
    """JSON text of every value, keys sorted; floats at full precision.

    Raises:
        PolicyFileError: A value is not JSON (NaN and infinities are not).
    """
    texts = {}
    for key in sorted(metadata):
        try:
            texts[key] = json.dumps(
                metadata[key], sort_keys=True, separators=(",", ":"), allow_nan=False
            )
        except (TypeError, ValueError) as error:
            raise PolicyFileError(f"metadata {key!r} cannot be written as JSON: {error}") from error
    return texts


def decode_metadata(texts: Mapping[str, str], name: str) -> dict[str, Any]:
    """Inverse of `encode_metadata`, with the keys that every policy file has checked.

    Args:
        texts: The `metadata_props` of the file.
        name: What to call the file in messages.

    Raises:
        PolicyFileError: A key is missing, a value is not JSON or the version is another.
    """
    missing = [key for key in REQUIRED_KEYS if key not in texts]
    if missing:
        raise PolicyFileError(
            f"{name} is an ONNX model without the metadata {missing} of a skewmi policy; "
            "write it with skewmi export-onnx"
        )
    metadata = {}
    for key, text in texts.items():
        try:
            metadata[key] = json.loads(text)
        except ValueError as error:
            raise PolicyFileError(f"{name}: metadata {key!r} is not JSON: {error}") from error
    version = metadata[FORMAT_KEY]
    if version != FORMAT_VERSION:
        raise PolicyFileError(
            f"{name} is a policy file of version {version}, this skewmi reads {FORMAT_VERSION}; "
            "export it again"
        )
    return metadata
