"""What a loop needs to keep its time on an ordinary Linux machine."""

from __future__ import annotations

import ctypes
import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager

_FIFO_PRIORITY = 40
"""Above ordinary threads, below the kernel's own interrupt threads (50)."""
_MCL_CURRENT_FUTURE_ONFAULT = 7
"""Pages stay once they have been touched; untouched reservations cost nothing."""


@contextmanager
def hot_loop(*, priority: bool) -> Iterator[list[str]]:
    """Keep the garbage collector, and where permitted paging and other threads, out of a loop.

    A full collection takes tens of milliseconds with our imports; inside, nothing is collected
    but by reference counting. On exit everything is as it was.

    Args:
        priority: Ask for SCHED_FIFO and locked memory. Only for loops that sleep: a spinning
            one would be throttled by the kernel.

    Yields:
        What was granted, for the report.
    """
    granted = ["gc frozen"]
    gc.collect()
    gc.freeze()
    was_enabled = gc.isenabled()
    gc.disable()
    policy = _ask_for_fifo() if priority else None
    if policy is not None:
        granted.append("SCHED_FIFO")
    if priority and _lock_memory():
        granted.append("memory locked")
    try:
        yield granted
    finally:
        if policy is not None:
            os.sched_setscheduler(0, policy, os.sched_param(0))
        gc.unfreeze()
        if was_enabled:
            gc.enable()


def _ask_for_fifo() -> int | None:
    """The former policy if the calling thread is real-time now, None if not permitted."""
    if not hasattr(os, "sched_setscheduler"):
        return None
    before = os.sched_getscheduler(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_FIFO_PRIORITY))
    except OSError:
        return None
    return before


def _lock_memory() -> bool:
    """Whether the process's pages are locked now; they stay so until it ends."""
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        return int(libc.mlockall(_MCL_CURRENT_FUTURE_ONFAULT)) == 0
    except (OSError, AttributeError):
        return False
