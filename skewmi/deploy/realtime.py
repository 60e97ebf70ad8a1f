"""What a loop needs to keep its time on an ordinary Linux machine."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

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
    before = _ask_for_fifo() if priority else {}
    if before:
        granted.append("SCHED_FIFO")
    if priority and _lock_memory():
        granted.append("memory locked")
    try:
        yield granted
    finally:
        for thread, policy in before.items():
            with suppress(OSError):  # it has ended
                os.sched_setscheduler(thread, policy, os.sched_param(0))
        gc.unfreeze()
        if was_enabled:
            gc.enable()


def _ask_for_fifo() -> dict[int, int]:
    """Make all threads of this process real-time; their former policies, empty if not permitted.

    All, because a loop is no earlier than the threads of the link that feed it: on a busy machine
    those wait 100 ms for their turn. The calling thread goes ahead of the others.
    """
    if not sys.platform.startswith("linux"):
        return {}
    own = threading.get_native_id()
    before: dict[int, int] = {}
    for thread in map(int, os.listdir("/proc/self/task")):
        priority = _FIFO_PRIORITY if thread == own else _FIFO_PRIORITY - 1
        # Processes and threads that are started from here are ordinary ones.
        fifo = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        try:
            policy = os.sched_getscheduler(thread)
            os.sched_setscheduler(thread, fifo, os.sched_param(priority))
        except PermissionError:
            return before
        except OSError:
            continue
        before[thread] = policy
    return before


def _lock_memory() -> bool:
    """Whether the process's pages are locked now; they stay so until it ends."""
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        return int(libc.mlockall(_MCL_CURRENT_FUTURE_ONFAULT)) == 0
    except (OSError, AttributeError):
        return False
