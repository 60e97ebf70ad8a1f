"""Reads recordings back: finished ones, and those whose writer was killed.

Metadata records named "skewmi" tell what a recording is about; the keys are here.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from skewmi.deploy.recording.writer import SENDER
from skewmi.errors import ConfigurationError

METADATA_NAME = "skewmi"
"""Name of our metadata records; later ones add to earlier ones."""
LAYOUT = "layout"
"""Key: the policy's layout as `PolicyLayout.to_json`."""
LIMITS = "limits"
"""Key: JSON object of limit name (position_lower, velocity, ...) to seven numbers."""
SCENE = "scene"
"""Key: JSON list of scene parts as `wire.scene_geometry.SceneGeometry`."""
BOX_POSE = "box_pose"
"""Key: where the task's box was known to stand, a JSON object as `RobotDescription.box_pose`: the
scene is in its frame. Missing if nobody had looked for it."""
VARIATION = "variation"
"""Key: how the simulated robot differs from the nominal one; a file's name or its text."""
LOCK_STEP = "lock_step"
"""Key: "True" if robot server and session waited for each other."""
BELIEVED = "believed"
"""Key: JSON object of topic to the hexadecimal global ids of the senders that were recorded."""
STRANGERS = "strangers"
"""Key: JSON list of `wire.senders.Stranger`, whose messages were not recorded."""

_TORN = (
    McapError,
    ValueError,  # a checksum or text that is not right
    struct.error,
    OSError,
    RuntimeError,  # lz4
    MemoryError,
    OverflowError,  # a length that no file can have
    zstandard.ZstdError,
)
"""What the MCAP reader raises where a file has been cut off or damaged."""

_MAGIC = b"\x89MCAP0\r\n"


@dataclass(frozen=True)
class RecordedMessage:
    """One message of a recording."""

    payload: bytes
    sequence: int
    log_time_ns: int
    """Wall clock of the recorder, ns since 1970."""
    publish_time_ns: int
    """Wall clock of the publisher, ns since 1970."""
    sender: str = ""
    """Hexadecimal global id of the publisher; empty if the file does not tell."""


@dataclass(frozen=True)
class Recording:
    """A whole recording in memory."""

    path: Path
    messages: Mapping[str, Sequence[RecordedMessage]]
    """By topic name, in the order of recording."""
    types: Mapping[str, str]
    """ROS type by topic name."""
    metadata: Mapping[str, str]
    """Ours, all records merged."""
    complete: bool
    """False if the file ends early: its writer was killed, or it is still being written."""


def run_metadata(
    *,
    layout_json: str | None = None,
    limits: Mapping[str, Sequence[float]] | None = None,
    scene: str | None = None,
    **others: str,
) -> dict[str, str]:
    """Metadata for a `Recorder`, under the keys that replay looks for.

    Args:
        layout_json: `PolicyLayout.to_json()`.
        limits: Per joint, chain order: position_lower, position_upper, velocity, ...
        scene: `SceneGeometry.to_json()`.
        others: Anything worth keeping: policy file, its sha256, robot server description, seed.
    """
    metadata = dict(others)
    if layout_json is not None:
        metadata[LAYOUT] = layout_json
    if limits is not None:
        metadata[LIMITS] = json.dumps({name: list(map(float, v)) for name, v in limits.items()})
    if scene is not None:
        metadata[SCENE] = scene
    return metadata


def read_recording(path: Path) -> Recording:
    """Read all of a recording.

    Raises:
        ConfigurationError: There is no such file, it is no MCAP file, or holds no message.
    """
    path = Path(path)
    if not path.is_file():
        raise ConfigurationError(f"no recording at {path}")
    with path.open("rb") as file:
        magic = file.read(len(_MAGIC))
        if magic != _MAGIC:
            raise ConfigurationError(
                f"{path} is not an MCAP recording"
                + (" (it is empty)" if not magic else f" (it begins with {magic!r})")
            )
        file.seek(0)
        recording = _read(path, file)
    if not any(recording.messages.values()):
        raise ConfigurationError(f"{path} holds no message")
    return recording


def _read(path: Path, file: Any) -> Recording:
    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    messages: dict[str, list[RecordedMessage]] = {}
    types: dict[str, str] = {}
    metadata: dict[str, str] = {}
    complete = True
    try:
        # Front to back, without the index at the end: that is what an unfinished file lacks.
        size = path.stat().st_size
        for record in StreamReader(file, validate_crcs=True, record_size_limit=size).records:
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                channels[record.id] = record.topic, record.metadata.get(SENDER, "")
                types[record.topic] = schemas.get(record.schema_id, "")
                messages.setdefault(record.topic, [])
            elif isinstance(record, Message) and record.channel_id in channels:
                topic, sender = channels[record.channel_id]
                messages[topic].append(
                    RecordedMessage(
                        record.data, record.sequence, record.log_time, record.publish_time, sender
                    )
                )
            elif isinstance(record, Metadata) and record.name == METADATA_NAME:
                metadata.update(record.metadata)
    except _TORN:
        complete = False
    return Recording(path, messages, types, metadata, complete)
