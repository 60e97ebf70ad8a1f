"""Where a live view goes: a viewer, a file, a page; several at once."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import rerun as rr

from skewmi.child_process import WORK_S
from skewmi.deploy.replay import viewer, web
from skewmi.deploy.replay.rerun_file import whole_at_end
from skewmi.errors import OutputError

_FLUSH_TIMEOUT_S = 3.0
_FLUSH_LONGEST_S = 30.0


class Streams:
    """A Rerun stream to each place that the task asks for: a dead one must not hold up another.

    Args:
        streams: Rerun's.
        file: That the first of them writes; None if all go to viewers.

    Attributes:
        all: The streams.
        broken: Once they are finished: why the file is not whole; empty if it is.
    """

    def __init__(self, streams: list[Any], file: Path | None = None) -> None:
        self.all, self._file = streams, file
        self.broken = ""

    @staticmethod
    def open(task: dict[str, Any], application: str) -> Streams:
        """Open all of them.

        Args:
            task: "title", and where: "spawn" (whether), "connect" (an address), "out" (a file),
                "web" (ports of data and page); none of what is None.
            application: What Rerun calls it.

        Raises:
            ConfigurationError: A viewer cannot be started or reached.
        """
        name = f"{Path(task['title']).name} {time.strftime('%H:%M:%S')}"
        streams: list[Any] = []
        if task["out"] is not None:
            streams.append(_open(application, name, rr.FileSink(task["out"])))
        if task["web"] is not None:
            streams.append(rr.RecordingStream(application))
            web.serve(streams[-1], tuple(task["web"]))
            streams[-1].send_recording_name(name)
        if task["spawn"]:
            url = viewer.spawn_viewer(
                "use --live-out FILE, or --live-connect where there is a screen"
            )
            streams.append(_open(application, name, rr.GrpcSink(url)))
        if task["connect"] is not None:
            viewer.require_viewer(task["connect"])
            streams.append(_open(application, name, rr.GrpcSink(task["connect"])))
        return Streams(streams, None if task["out"] is None else Path(task["out"]))

    def finish(self) -> bool:
        """Send what is left, the file first; whether everything was taken in time."""
        viewers = self.all
        if self._file is not None:
            file, *viewers = self.all
            try:
                with whole_at_end(self._file, self._file):
                    _end(file)
            except OutputError as error:
                self.broken = str(error)
                _tell(error)
        for stream in viewers:
            try:
                _end(stream)
            except (RuntimeError, ValueError) as error:
                _tell(error)
                return False
        return not self.broken


def _tell(error: Exception) -> None:
    sys.stderr.write(f"{' '.join(str(error).split())}\n")


def _end(stream: Any) -> None:
    """Send what is left, and nothing more.

    Raises:
        RuntimeError, ValueError: It is not taken.
    """
    _flush(stream)
    stream.disconnect()


def _flush(stream: Any) -> None:
    """Send what is left, for as long as this process gets on with it.

    Raises:
        RuntimeError, ValueError: It is not taken.
    """
    until = time.monotonic() + _FLUSH_LONGEST_S
    while True:
        before = time.process_time()
        try:
            stream.flush(timeout_sec=_FLUSH_TIMEOUT_S)
            return
        except (RuntimeError, ValueError):
            idle = time.process_time() - before < WORK_S
            if idle or time.monotonic() > until:
                raise


def _open(application: str, name: str, sink: Any) -> Any:
    stream = rr.RecordingStream(application)
    stream.set_sinks(sink)
    stream.send_recording_name(name)
    return stream
