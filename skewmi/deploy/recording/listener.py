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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from skewmi.child import tell_parent
from skewmi.deploy.wire.channels import LatestReader, Sample
from skewmi.deploy.wire.senders import Senders, Stranger, gids_of
from skewmi.deploy.wire.topics import TOPICS, YUMI_DESCRIBE, Topic
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import TransportError

_ANSWER_S = 5.0

_LINGER_S = 0.1
"""After the end: what is still under way belongs to the run."""


class Counts:
    """Messages received, gaps in the publishers' sequences, and who was not believed.

    Args:
        senders: Who is believed.
    """

    def __init__(self, senders: Senders) -> None:
        self.senders = senders
        self.messages = 0
        self.missed = 0
        self._last: dict[bytes, int] = {}

    def as_dict(self) -> dict[str, Any]:
        """Last words for the owner, see `strangers_told`."""
        strangers = [asdict(stranger) for stranger in self.senders.strangers()]
        return {"messages": self.messages, "missed": self.missed, "strangers": strangers}

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
    on_line: Callable[[dict[str, Any]], None],
    on_believed: Callable[[dict[str, list[str]]], None] = lambda believed: None,
    topics: Sequence[Topic] = TOPICS,
) -> Counts:
    """Subscribe to topics, and hand over what believed senders say until the owner ends it.

    Who is believed stands in the task, and in later lines, under "believed": lists of hexadecimal
    global ids by topic, which replace those before. Without it everybody is, the first sixteen on
    each topic.

    Args:
        link: An open one.
        source: Where the owner's lines come from.
        period_s: How often to look, s.
        on_sample: Given each message, in the order of its topic.
        on_round: Called after each look.
        on_line: Given each other line of the owner.
        on_believed: Given each such list, before any message of its senders.
        topics: What to listen to; everything by default.
    """
    believed = source.task.get("believed")
    senders = Senders(link.graph.node_of, everybody=believed is None)
    counts = Counts(senders)

    def believe(publishers: dict[str, list[str]]) -> None:
        senders.believe(gids_of(publishers))
        on_believed(publishers)

    if believed is not None:
        believe(believed)
    readers = _subscribed(link, topics, senders)
    tell_parent(ready=True)
    end_s = float("inf")
    while True:
        # Looked at before the topics, so that what came before the end is handed over.
        ending = time.monotonic() >= end_s
        _hand_over(readers, counts, on_sample)
        on_round()
        if ending:
            return counts
        try:
            line = source.lines.get(timeout=period_s)
        except Empty:
            continue
        if line is None:
            end_s = time.monotonic() + _LINGER_S
            continue
        content = json.loads(line)
        if "believed" in content:
            believe(content["believed"])
        else:
            on_line(content)


def _subscribed(
    link: Link, topics: Sequence[Topic], senders: Senders
) -> list[tuple[Topic, LatestReader]]:
    """Readers of topics, once the robot server knows of them."""
    # Unread samples pile up here in memory, never in Zenoh, where they would slow others.
    readers = [(topic, link.subscribe(topic, None, senders)) for topic in topics]
    # What travels on a link keeps its order: once the robot server has answered, it knows what we
    # subscribe to. Not everything that publishes serves descriptions.
    with contextlib.suppress(TransportError):
        link.call(YUMI_DESCRIBE, _ANSWER_S)
    return readers


def _hand_over(
    readers: list[tuple[Topic, LatestReader]],
    counts: Counts,
    on_sample: Callable[[Topic, Sample], None],
) -> None:
    for topic, reader in readers:
        for sample in reader.drain():
            counts.add(sample.gid, sample.sequence)
            on_sample(topic, sample)


def strangers_told(words: Mapping[str, Any]) -> tuple[Stranger, ...]:
    """Strangers of a listener's last words.

    Raises:
        ValueError: They are not such words.
    """
    try:
        return tuple(Stranger(**stranger) for stranger in words["strangers"])
    except (KeyError, TypeError) as error:
        raise ValueError(f"the process's last words are not understood ({error})") from error
