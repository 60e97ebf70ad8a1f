"""Writes messages to an MCAP file that stays readable however the writer ends."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import Writer

from skewmi.deploy.wire import ros2_types
from skewmi.deploy.wire.topics import Topic

CHUNK_BYTES = 32 * 1024
"""Small, since an unfinished chunk is what a kill of the writer loses: at most 60 ms of a
running arm, 0.7 s of a resting one."""

SENDER = "skewmi_publisher_gid"
"""Key of a channel's metadata: hexadecimal global id of the one publisher whose messages it has."""

_SEQUENCE_MASK = 0xFFFFFFFF


class RecordingWriter:
    """One MCAP file of ROS 2 messages; a context manager that finishes it."""

    def __init__(self, path: Path) -> None:
        """Create the file, replacing an existing one.

        Raises:
            OSError: It cannot be created.
        """
        self._file = path.open("wb")
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES)
        self._writer.start(profile=Profile.ROS2, library="skewmi")
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, bytes], int] = {}

    def write(
        self,
        topic: Topic,
        payload: bytes,
        *,
        sequence: int = 0,
        log_time_ns: int | None = None,
        publish_time_ns: int | None = None,
        sender: bytes = b"",
    ) -> None:
        """Add a message; nothing that its sender may have written is refused.

        Args:
            topic: Where it was published.
            payload: Its CDR bytes.
            sequence: Publisher's count; the file keeps its low 32 bits.
            log_time_ns: Wall clock now, ns since 1970; None looks at the clock.
            publish_time_ns: Publisher's wall clock, ns since 1970; None means `log_time_ns`.
                Earlier ones are written as 0.
            sender: Global id of its publisher; each has a channel of its own. Empty if unknown.

        Raises:
            OSError: The file cannot be written.
        """
        if log_time_ns is None:
            log_time_ns = time.time_ns()
        if publish_time_ns is None:
            publish_time_ns = log_time_ns
        # On the wire all of these are int64. One that MCAP's fields cannot hold would leave half
        # a record in the open chunk, which then nobody can read.
        self._writer.add_message(
            self._channel(topic, sender),
            max(0, log_time_ns),
            payload,
            max(0, publish_time_ns),
            sequence & _SEQUENCE_MASK,
        )

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record, and write it through to the file."""
        self._writer.add_metadata(name, dict(values))
        self.flush()

    def flush(self) -> None:
        """Hand finished chunks to the operating system: a kill cannot take them back."""
        self._file.flush()

    def close(self) -> None:
        """Finish the file."""
        if not self._file.closed:
            self._writer.finish()
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _channel(self, topic: Topic, sender: bytes) -> int:
        channel = self._channels.get((topic.name, sender))
        if channel is None:
            type_name = topic.type_name
            if type_name not in self._schemas:
                self._schemas[type_name] = self._writer.register_schema(
                    type_name, SchemaEncoding.ROS2, ros2_types.schema(type_name).encode()
                )
            details = {
                "offered_qos_profiles": "",
                "topic_type_hash": ros2_types.type_hash(type_name),
            }
            if sender:
                details[SENDER] = sender.hex()
            channel = self._writer.register_channel(
                topic.name, MessageEncoding.CDR, self._schemas[type_name], details
            )
            self._channels[topic.name, sender] = channel
        return channel
