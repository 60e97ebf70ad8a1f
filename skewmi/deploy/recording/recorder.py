"""Records everything on the link beside the hot loops: MCAP, written by a process of its own.

The recorder is one more subscriber. It costs daemon and endpoint nothing but the sending of
what they send anyway, and its interpreter lock, garbage collector and disk cannot hold them
up. It outlives the process that started it: if that is killed, its end of a pipe closes, and
the recording is finished properly. If the recorder itself is killed, what it wrote remains
readable (`recording.read_recording`, or any MCAP reader that allows a missing end).

The file holds the very bytes that went over the wire, with ROS 2 schemas, so that ROS 2 tools,
Foxglove and Rerun read it; and metadata under the name "skewmi" (`recording`).
"""

from __future__ import annotations

import contextlib
import json
import select
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Self

from skewmi.deploy.recording.reader import METADATA_NAME
from skewmi.deploy.wire.transport import TransportConfig
from skewmi.errors import ConfigurationError, TransportError

_START_TIMEOUT_S = 20.0
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


class Recorder:
    """Records all topics of a link; a context manager that finishes the file."""

    def __init__(
        self,
        path: Path,
        config: TransportConfig,
        metadata: Mapping[str, str] | None = None,
        *,
        overwrite: bool = False,
    ) -> None:
        """Start recording; returns once everything is subscribed to.

        Args:
            path: File to write, usually ending in .mcap.
            config: How to reach the endpoint; only its locators, file and domain matter.
            metadata: What the run is about; see `recording.run_metadata`.
            overwrite: Replace an existing file.

        Raises:
            ConfigurationError: The file exists, or its folder does not.
            TransportError: Nobody answers, or the process does not start.
        """
        path = Path(path)
        if path.exists() and not overwrite:
            raise ConfigurationError(f"{path} exists already; choose another file to record to")
        if not path.parent.is_dir():
            raise ConfigurationError(f"cannot record to {path}: there is no folder {path.parent}")
        path.unlink(missing_ok=True)
        self.path = path
        self._summary: RecordingSummary | None = None
        # A recorder connects even if its owner listens; in a session of its own, so that
        # Ctrl-C reaches the daemon only.
        client = replace(config, connect=config.connect or config.listen, listen=())
        self._process = subprocess.Popen(
            [sys.executable, "-m", "skewmi.deploy.recording.recorder_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
            text=True,
        )
        self._write({"path": str(path), "config": _config_json(client)})
        assert self._process.stdout is not None
        ready, _, _ = select.select([self._process.stdout], [], [], _START_TIMEOUT_S)
        if not ready or not self._process.stdout.readline():
            self._process.kill()
            raise TransportError(f"cannot record to {path}: {self._reason()}")
        if metadata:
            self.add_metadata(metadata)

    def add_metadata(self, metadata: Mapping[str, str]) -> None:
        """Add to the recording's metadata, such as the outcome; not for the hot loop."""
        self._write({"metadata": [METADATA_NAME, dict(metadata)]})

    def close(self) -> RecordingSummary:
        """Finish the file and wait for it; safe to call twice.

        Raises:
            TransportError: The recorder failed; what it wrote remains.
        """
        if self._summary is None:
            try:
                # Closes the pipe: that is how the recorder learns that this was all.
                out, _ = self._process.communicate(timeout=_CLOSE_TIMEOUT_S)
                counts = json.loads(out)
            except (subprocess.TimeoutExpired, ValueError) as error:
                self._process.kill()
                raise TransportError(
                    f"recording {self.path} stopped early: {self._reason()}"
                ) from error
            size = self.path.stat().st_size
            self._summary = RecordingSummary(self.path, size_bytes=size, **counts)
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

    def _write(self, content: object) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):  # it has died: `close` tells
            self._process.stdin.write(json.dumps(content) + "\n")
            self._process.stdin.flush()

    def _reason(self) -> str:
        assert self._process.stderr is not None
        self._process.wait()
        # After `communicate` the pipe is closed.
        lines = [] if self._process.stderr.closed else self._process.stderr.read().splitlines()
        return lines[-1] if lines else "the recorder process was killed or hung"


def _config_json(config: TransportConfig) -> dict[str, object]:
    content = asdict(config)
    if config.zenoh_config is not None:
        content["zenoh_config"] = str(config.zenoh_config)
    return content
