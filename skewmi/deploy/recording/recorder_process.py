"""The process behind `recorder.Recorder`: subscribes to every topic and writes an MCAP file.

    python -m skewmi.deploy.recording.recorder_process

Standard input: lines of JSON, first {"path", "config"}, then any {"metadata": [name, values]};
its end ends the recording. Standard output: a line when ready, the counts at the end.
"""

from __future__ import annotations

import json
import signal
import sys
import threading
import time
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.wire.topics import TOPICS
from skewmi.deploy.wire.transport import LatestReader, Link, TransportConfig
from skewmi.errors import SkewmiError

_PERIOD_S = 0.005
_LINGER_S = 0.1
"""After the end: what is still under way shall be in the recording."""


class _Counts:
    """Messages written, and gaps in the publishers' sequences."""

    def __init__(self) -> None:
        self.messages = 0
        self.missed = 0
        self._last: dict[bytes, int] = {}

    def add(self, gid: bytes, sequence: int) -> None:
        last = self._last.get(gid)
        self.messages += 1
        if last is not None:
            self.missed += max(0, sequence - last - 1)
        self._last[gid] = sequence


def _record(path: Path, config: TransportConfig, lines: SimpleQueue[str | None]) -> _Counts:
    counts = _Counts()
    with Link.open(config, "skewmi_recorder") as link, RecordingWriter(path) as writer:
        # Unread samples pile up here in memory, never in Zenoh, where they would slow others.
        readers = [(topic, link.subscribe(topic, depth=None)) for topic in TOPICS]
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        end_s = float("inf")
        while True:
            # Looked at before the topics, so that what came before the end is written.
            ending = time.monotonic() >= end_s
            for topic, reader in readers:
                _drain(topic, reader, writer, counts)
            writer.flush()
            if ending:
                return counts
            try:
                line = lines.get(timeout=_PERIOD_S)
            except Empty:
                continue
            if line is None:
                end_s = time.monotonic() + _LINGER_S
            else:
                writer.add_metadata(*json.loads(line)["metadata"])


def _drain(topic: Any, reader: LatestReader, writer: RecordingWriter, counts: _Counts) -> None:
    for sample in reader.drain():
        counts.add(sample.gid, sample.sequence)
        writer.write(
            topic,
            sample.payload,
            sequence=sample.sequence,
            publish_time_ns=sample.source_time_ns,
        )


def main() -> int:
    """Record until standard input ends. Returns the exit code; failures go to stderr."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    first = json.loads(sys.stdin.readline())
    options = first["config"]
    for name in ("connect", "listen"):
        options[name] = tuple(options[name])
    if options["zenoh_config"] is not None:
        options["zenoh_config"] = Path(options["zenoh_config"])
    lines: SimpleQueue[str | None] = SimpleQueue()
    threading.Thread(target=_read_lines, args=(lines,), daemon=True).start()
    try:
        counts = _record(Path(first["path"]), TransportConfig(**options), lines)
    except (SkewmiError, OSError) as error:
        sys.stderr.write(f"{' '.join(str(error).split())}\n")
        return 1
    sys.stdout.write(json.dumps({"messages": counts.messages, "missed": counts.missed}))
    return 0


def _read_lines(lines: SimpleQueue[str | None]) -> None:
    for line in sys.stdin:
        lines.put(line)
    lines.put(None)


if __name__ == "__main__":
    sys.exit(main())
