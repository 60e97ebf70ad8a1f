"""The signals that end a command smoothly."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Ctrl-C, kill, and the end of the terminal or of the connection to it."""


def signals_to_handle() -> tuple[signal.Signals, ...]:
    """`ENDING_SIGNALS`, but for the end of the terminal where it is ignored, as under nohup.

    A Ctrl-C that is ignored, as in a script's background jobs, is handled all the same.
    """
    outlives = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return tuple(n for n in ENDING_SIGNALS if not (outlives and n is signal.SIGHUP))


@contextmanager
def stop_on_signal() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C, SIGTERM or SIGHUP sets; a second one ends the process."""
    stop = threading.Event()
    before = {number: signal.getsignal(number) for number in signals_to_handle()}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def handle(number: int, frame: object) -> None:
        del number, frame
        restore()
        stop.set()

    for number in before:
        signal.signal(number, handle)
    try:
        yield stop
    finally:
        restore()
