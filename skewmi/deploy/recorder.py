"""Records messages beside the hot loop: MCAP, written by a process of its own.

`Recorder.record` appends the message to a queue and returns. A thread looks there every few
milliseconds and passes everything on through a pipe; it spends its time in system calls, not
holding the interpreter lock. Compressing and writing happen in another process, whose
interpreter lock, garbage collector and disk cannot hold up the loop. That process outlives
ours: if the daemon is killed, the pipe closes, and the recording is finished properly. If the
recording process itself is killed, what it wrote remains readable
(`recording.read_recording`, or any MCAP reader that allows a missing end).

The file holds the very bytes that went over the wire, with ROS 2 schemas, so that ROS 2 tools,
Foxglove and Rerun read it; and metadata under the name "skewmi" (`recording`).
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import struct
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from skewmi.deploy import ros2_types
from skewmi.deploy.recording import METADATA_NAME
from skewmi.deploy.topics import Topic
from skewmi.errors import ConfigurationError, TransportError

CHANNEL, MESSAGE, METADATA = range(3)
"""Kinds of packets to the recording process; each begins with `PACKET`."""
PACKET = struct.Struct("<IHHIqq")
"""Length of what follows, kind, channel, sequence, log time ns, publish time ns."""

MAX_QUEUED = 10_000
"""Messages. About a minute of a running arm; more than that is not kept in memory."""

_PIPE_BYTES = 1 << 20
_PERIOD_S = 0.004
_CLOSE_TIMEOUT_S = 20.0


@dataclass(frozen=True)
class RecordingSummary:
    """What became of a recording."""

    path: Path
    messages: int
    """Messages handed over."""
    dropped: int
    """Messages lost because the recording process could not keep up, or had died."""
    size_bytes: int


class Recorder:
    """Writes one MCAP file; a context manager that finishes it.

    `record` may be called from one thread only.
    """

    def __init__(
        self,
        path: Path,
        metadata: Mapping[str, str] | None = None,
        *,
        lossless: bool = False,
        overwrite: bool = False,
    ) -> None:
        """Start the recording process.

        Args:
            path: File to write, usually ending in .mcap.
            metadata: See `recording.run_metadata`.
            lossless: Wait for the recording process when it cannot keep up (lock-step), rather
                than drop the message (real time).
            overwrite: Replace an existing file.

        Raises:
            ConfigurationError: The file exists, or its folder does not.
        """
        path = Path(path)
        if path.exists() and not overwrite:
            raise ConfigurationError(f"{path} exists already; choose another file to record to")
        if not path.parent.is_dir():
            raise ConfigurationError(f"cannot record to {path}: no folder {path.parent}")
        path.unlink(missing_ok=True)
        self.path = path
        self._lossless = lossless
        self._channels: dict[str, int] = {}
        self._queue: deque[tuple[bytes, bytes]] = deque()
        self._messages = 0
        self._dropped = 0
        self._closing = False
        self._summary: RecordingSummary | None = None
        # In a session of its own, so that Ctrl-C reaches the daemon only.
        self._process = subprocess.Popen(
            [sys.executable, "-m", "skewmi.deploy.recorder_process", str(path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
            bufsize=0,
        )
        assert self._process.stdin is not None
        with contextlib.suppress(OSError, AttributeError):  # Linux; else the default will do
            fcntl.fcntl(self._process.stdin.fileno(), fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        self._thread = threading.Thread(target=self._forward, name="skewmi-recorder", daemon=True)
        self._thread.start()
        if metadata:
            self.add_metadata(METADATA_NAME, metadata)

    def add_topic(self, topic: Topic) -> None:
        """Announce a topic; done by the first `record` of it otherwise, which then takes longer."""
        if topic.name in self._channels:
            return
        channel = self._channels[topic.name] = len(self._channels) + 1
        content = json.dumps(
            {
                "topic": topic.name,
                "type": topic.type_name,
                "schema": ros2_types.schema(topic.type_name),
                "hash": ros2_types.type_hash(topic.type_name),
            }
        ).encode()
        self._queue.append((PACKET.pack(len(content), CHANNEL, channel, 0, 0, 0), content))

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record; not for the hot loop."""
        content = json.dumps([name, dict(values)]).encode()
        self._queue.append((PACKET.pack(len(content), METADATA, 0, 0, 0, 0), content))

    def record(
        self, topic: Topic, payload: bytes, *, sequence: int = 0, publish_time_ns: int = 0
    ) -> None:
        """Hand over a message. Never raises, and waits only if the recorder is `lossless`.

        Args:
            topic: Where it was, or would have been, published.
            payload: Its CDR bytes.
            sequence: Publisher's count.
            publish_time_ns: Publisher's wall clock, ns since 1970; 0 means now.
        """
        channel = self._channels.get(topic.name)
        if channel is None:
            self.add_topic(topic)
            channel = self._channels[topic.name]
        self._messages += 1
        if len(self._queue) >= MAX_QUEUED and not self._wait_for_room():
            self._dropped += 1
            return
        now_ns = time.time_ns()
        published_ns = publish_time_ns or now_ns
        header = PACKET.pack(len(payload), MESSAGE, channel, sequence, now_ns, published_ns)
        self._queue.append((header, payload))

    def close(self) -> RecordingSummary:
        """Finish the file and wait for it; safe to call twice.

        Raises:
            TransportError: The recording process failed; what it wrote remains.
        """
        if self._summary is not None:
            return self._summary
        self._closing = True
        self._thread.join(_CLOSE_TIMEOUT_S)
        try:
            # Closes the pipe: that is how the process learns that this was all.
            _, error = self._process.communicate(timeout=_CLOSE_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            _, error = self._process.communicate()
            error = error or b"it did not finish in time"
        size = self.path.stat().st_size if self.path.exists() else 0
        self._summary = RecordingSummary(self.path, self._messages, self._dropped, size)
        if self._process.returncode != 0:
            reason = (error.decode(errors="replace").strip().splitlines() or ["killed"])[-1]
            raise TransportError(f"recording {self.path} stopped early: {reason}")
        return self._summary

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            self.close()
        else:
            # What went wrong first matters more than what went wrong with the recording.
            with contextlib.suppress(TransportError):
                self.close()

    def _wait_for_room(self) -> bool:
        """Whether there is room in the queue, after waiting for it if nothing may be lost."""
        while self._lossless and self._thread.is_alive() and len(self._queue) >= MAX_QUEUED:
            time.sleep(_PERIOD_S)
        return len(self._queue) < MAX_QUEUED

    def _forward(self) -> None:
        """Thread: pass queued packets on until closed, or until the process has died."""
        pipe = self._process.stdin
        assert pipe is not None
        while True:
            # Read before the queue, so that nothing queued before `close` is left behind.
            closing = self._closing
            while self._queue:
                try:
                    _write_all(pipe.fileno(), *self._queue.popleft())
                except OSError:
                    return  # `close` tells why
            if closing:
                return
            time.sleep(_PERIOD_S)


def _write_all(descriptor: int, header: bytes, payload: bytes) -> None:
    written = os.writev(descriptor, (header, payload))
    rest = memoryview(header + payload)[written:] if written < len(header) + len(payload) else b""
    while rest:
        rest = rest[os.write(descriptor, rest) :]
