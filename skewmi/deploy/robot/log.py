"""What a robot server logs, told from a thread of its own.

The loop that keeps the arm safe must not wait for a terminal, a pipe or a disk. So whatever is
logged is put into a queue that never waits; what does not fit in it is dropped and counted.
"""

from __future__ import annotations

import copy
import logging
import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from logging.handlers import QueueHandler

QUEUED = 256
"""Lines that wait to be told."""

_END_S = 5.0
"""How long the end waits for the last lines."""


class BoundedQueueHandler(QueueHandler):
    """Puts records into a queue, if there is room. Each becomes one line: no traceback.

    Putting a traceback together reads source files, and who sends nonsense could have it done
    thousands of times a second.

    Args:
        records: Where to put them; has a greatest size.
    """

    def __init__(self, records: queue.Queue[logging.LogRecord | None]) -> None:
        super().__init__(records)
        self.dropped = 0
        """Records for which there was no room."""

    def prepare(self, record: logging.LogRecord) -> logging.LogRecord:
        """The record with its message made up, and an error in a word in place of its trace."""
        text = record.getMessage()
        if record.exc_info and record.exc_info[1] is not None:
            text += f": {record.exc_info[1]!r}"
        record = copy.copy(record)
        record.msg = record.message = " ".join(text.splitlines())
        record.args = record.exc_info = record.exc_text = record.stack_info = None
        return record

    def enqueue(self, record: logging.LogRecord) -> None:
        """Put it there, or count it."""
        try:
            self.queue.put_nowait(record)
        except queue.Full:
            self.dropped += 1


@contextmanager
def told_from_a_thread(tell: Callable[[str], None]) -> Iterator[BoundedQueueHandler]:
    """Tell what the package logs, from INFO on, while the block runs; nothing is told elsewhere.

    Args:
        tell: Given each line, in a thread of its own; may wait as long as it likes.
    """
    records: queue.Queue[logging.LogRecord | None] = queue.Queue(QUEUED)
    logger, handler = logging.getLogger("skewmi"), BoundedQueueHandler(records)

    def tell_all() -> None:
        told = 0
        while (record := records.get()) is not None:
            tell(record.getMessage())
            if (missing := handler.dropped - told) > 0:
                told += missing
                tell(f"{missing} lines were not told: there were too many at once")

    thread = threading.Thread(target=tell_all, name="skewmi-log", daemon=True)
    before = logger.level, logger.propagate
    logger.setLevel(logging.INFO)
    # Whoever listens at the root would write from the loop.
    logger.propagate = False
    logger.addHandler(handler)
    thread.start()
    try:
        yield handler
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before[0])
        logger.propagate = before[1]
        with suppress(queue.Full):
            records.put(None, timeout=_END_S)
        thread.join(_END_S)
