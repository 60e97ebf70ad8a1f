"""Records everything on the link beside the hot loops: MCAP, written by a process of its own.

What that process costs, and what becomes of it when somebody is killed, is in `listener_process`.
If the recorder itself is killed, what it wrote remains readable (`reader.read_recording`, or any
MCAP reader that allows a missing end).

The file holds the very bytes that went over the wire, with ROS 2 schemas, so that ROS 2 tools,
Foxglove and Rerun read it; and metadata under the name "skewmi" (`reader`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from skewmi.child_process import ChildStartError
from skewmi.deploy.recording.listener import strangers_told
from skewmi.deploy.recording.listener_process import ListenerProcess
from skewmi.deploy.recording.reader import METADATA_NAME
from skewmi.deploy.wire.senders import Stranger
from skewmi.deploy.wire.transport import TransportConfig
from skewmi.errors import TransportError
from skewmi.outputs import check_output, writing

_CLOSE_TIMEOUT_S = 20.0


@dataclass(frozen=True)
class RecordingSummary:
    """What became of a recording."""

    path: Path
    messages: int
    """Messages written."""
    missed: int
    """Messages that were published and did not arrive, by the gaps in their sequences."""
    size_bytes: int
    strangers: tuple[Stranger, ...] = ()
    """Whose messages were left out."""


class Recorder:
    """Records all topics of a link; a context manager that finishes the file; `start` makes one.

    Args:
        path: The file that is written.
        listener: Writes it.
    """

    def __init__(self, path: Path, listener: ListenerProcess) -> None:
        self.path = path
        self._listener = listener
        self._summary: RecordingSummary | None = None

    @classmethod
    def start(
        cls,
        path: Path,
        config: TransportConfig,
        metadata: Mapping[str, str] | None = None,
        *,
        believed: Mapping[str, Sequence[str]] | None = None,
        overwrite: bool = False,
    ) -> Self:
        """Start recording; returns once everything is subscribed to.

        Args:
            path: File to write, usually ending in .mcap.
            config: How to reach the robot server; only its locators, file and domain matter.
            metadata: What the run is about; see `recording.run_metadata`.
            believed: Whose messages to record: hexadecimal global ids by topic, see
                `session.trust`. None records everybody, the first sixteen on each topic: for
                looking at a link, as nobody knows then who has sent what.
            overwrite: Replace an existing file.

        Raises:
            OutputError: The file exists, or its folder cannot be written.
            TransportError: Nobody answers, or the process does not start.
        """
        path = Path(path)
        check_output(path, overwrite=overwrite)
        with writing(path):
            path.unlink(missing_ok=True)
        try:
            listener = ListenerProcess.start(
                "skewmi.deploy.recording.recorder_process",
                config,
                {"path": str(path), "believed": believed},
            )
        except ChildStartError as error:
            raise TransportError(f"cannot record to {path}: {error}") from error
        recorder = cls(path, listener)
        if metadata:
            recorder.add_metadata(metadata)
        return recorder

    def add_metadata(self, metadata: Mapping[str, str]) -> None:
        """Add to the recording's metadata, such as the outcome; not for the hot loop."""
        self._listener.write({"metadata": [METADATA_NAME, dict(metadata)]})

    def believe(self, believed: Mapping[str, Sequence[str]]) -> None:
        """Record these senders from now on, and nobody else; see `start`."""
        self._listener.write({"believed": believed})

    def close(self) -> RecordingSummary:
        """Finish the file and wait for it; safe to call twice.

        Raises:
            TransportError: The recorder failed; what it wrote remains.
        """
        if self._summary is None:
            try:
                counts = self._listener.finish(_CLOSE_TIMEOUT_S)
                strangers = strangers_told(counts)
            except (TimeoutError, ValueError) as error:
                raise TransportError(
                    f"recording {self.path} stopped early: {self._listener.reason()}"
                ) from error
            size = self.path.stat().st_size
            self._summary = RecordingSummary(
                self.path, counts["messages"], counts["missed"], size, strangers
            )
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
