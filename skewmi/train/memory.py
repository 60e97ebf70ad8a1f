"""One allocator setting that nearly doubles the update rate on a CPU."""

from __future__ import annotations

import ctypes

_M_TRIM_THRESHOLD = -1  # malloc.h
_M_MMAP_THRESHOLD = -3


def keep_freed_memory() -> bool:
    """Let glibc keep freed blocks of up to 32 MiB instead of returning them to the system.

    Activations of a batch are some 256 KiB each. Above glibc's thresholds every one of them is
    mapped and unmapped again, and the page faults cost as much as the arithmetic.

    Returns:
        Whether the allocator took the setting; it does not outside glibc.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):
        return False
    # 32 MiB is the largest mmap threshold that glibc accepts.
    return bool(mallopt(_M_MMAP_THRESHOLD, 32 << 20)) and bool(mallopt(_M_TRIM_THRESHOLD, 1 << 30))
