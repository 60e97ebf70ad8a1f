"""What a call costs beside another one, on whatever computer this is and whatever else it does."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np


def cost_ratio(
    call: Callable[[], object], reference: Callable[[], object], rounds: int = 200
) -> float:
    """Processor time of `call` over that of `reference`, taken in turns.

    Thread time of the quicker fifth: others use caches and cores, too, and a slow computer is slow
    at both. A time in seconds would be a test of the computer.
    """
    times = np.empty((rounds, 2))
    for row in times:
        for k, each in enumerate((call, reference)):
            began = time.thread_time()
            each()
            row[k] = time.thread_time() - began
    of_call, of_reference = np.percentile(times, 20, axis=0)
    return float(of_call / of_reference)
