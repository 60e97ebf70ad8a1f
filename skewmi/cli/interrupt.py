"""The signals that end a command smoothly."""

from __future__ import annotations

import signal

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Ctrl-C, kill, and the end of the terminal or of the connection to it."""


def signals_to_handle() -> tuple[signal.Signals, ...]:
    """`ENDING_SIGNALS`, but for the end of the terminal where it is ignored, as under nohup.

    A Ctrl-C that is ignored, as in a script's background jobs, is handled all the same.
    """
    outlives = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return tuple(n for n in ENDING_SIGNALS if not (outlives and n is signal.SIGHUP))
