"""Inside a process that listens to everything on a link: what recorder and live view share.

Standard input: lines of JSON, the first one the task with the link's configuration under
"config"; its end is the end of the run. Standard output: a line of `child.tell_parent` when
everything is subscribed to.
"""

from __future__ import annotations

import contextlib
import json
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from skewmi.child import tell_parent
from skewmi.deploy.wire.channels import Sample
from skewmi.deploy.wire.topics import TOPICS, YUMI_DESCRIBE, Topic
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import TransportError

_ANSWER_S = 5.0

_LINGER_S = 0.1
"""After the end: what is still under way belongs to the run."""


class Counts:
    """Messages received, and gaps in the publishers' sequences."""

    def __init__(self) -> None:
        self.messages = 0
        self.missed = 0
        self._last: dict[bytes, int] = {}

    def add(self, gid: bytes, sequence: int) -> None:
        """A message came from a publisher."""
        last = self._last.get(gid)
        self.messages += 1
        if last is not None:
            self.missed += max(0, sequence - last - 1)
        self._last[gid] = sequence


class Input:
    """What our owner says, read by a thread of its own; `open` makes one.

    Args:
        task: The owner's first line.
        on_end: Called in that thread when the owner has closed our standard input or died.
    """

    def __init__(self, task: dict[str, Any], on_end: Callable[[], None] | None) -> None:
        self.task = task
        self._on_end = on_end
        self.lines: SimpleQueue[str | None] = SimpleQueue()
        """Further lines; None at the end."""

    @staticmethod
    def open(on_end: Callable[[], None] | None = None) -> Input:
        """Wait for the owner's first line, and go on reading."""
        # Ctrl-C is for the owner, who closes our standard input when the arm rests.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        source = Input(json.loads(sys.stdin.readline()), on_end)
        threading.Thread(target=source._read, daemon=True).start()
        return source

    def transport(self) -> TransportConfig:
        """How to reach the robot server, from the task."""
        options = dict(self.task["config"])
        for name in ("connect", "listen"):
            options[name] = tuple(options[name])
        if options["zenoh_config"] is not None:
            options["zenoh_config"] = Path(options["zenoh_config"])
        return TransportConfig(**options)

    def _read(self) -> None:
        for line in sys.stdin:
            self.lines.put(line)
        self.lines.put(None)
        if self._on_end is not None:
            self._on_end()


def listen(
    link: Link,
    source: Input,
    period_s: float,
    *,
    on_sample: Callable[[Topic, Sample], None],
    on_round: Callable[[], None],
    on_line: Callable[[str], None],
) -> Counts:
    """Subscribe to everything, and hand it over until the owner ends the run.

    Args:
        link: An open one.
        source: Where the owner's lines come from.
        period_s: How often to look, s.
        on_sample: Given each message, in the order of its topic.
        on_round: Called after each look.
        on_line: Given each line of the owner.
    """
    counts = Counts()
    # Unread samples pile up here in memory, never in Zenoh, where they would slow others.
    readers = [(topic, link.subscribe(topic, depth=None)) for topic in TOPICS]
    # What travels on a link keeps its order: once the robot server has answered, it knows what we
    # subscribe to. Not everything that publishes serves descriptions.
    with contextlib.suppress(TransportError):
        link.call(YUMI_DESCRIBE, _ANSWER_S)
    tell_parent(ready=True)
    end_s = float("inf")
    while True:
        # Looked at before the topics, so that what came before the end is handed over.
        ending = time.monotonic() >= end_s
        for topic, reader in readers:
            for sample in reader.drain():
                counts.add(sample.gid, sample.sequence)
                on_sample(topic, sample)
        on_round()
        if ending:
            return counts
        try:
            line = source.lines.get(timeout=period_s)
        except Empty:
            continue
        if line is None:
            end_s = time.monotonic() + _LINGER_S
        else:
            on_line(line)
