"""How long each stage of a cycle takes."""

from __future__ import annotations

import time
from array import array
from collections.abc import Sequence

import numpy as np

BUSY_ADVICE = (
    "on a busy computer raise --lead-ms (up to 100), or give --lock-step with a simulated robot; "
    "`skewmi doctor` tells what this computer lacks"
)
"""What to do if states or commands come too late."""


class CycleTimes:
    """A stopwatch with named stages; each lap ends one stage and begins the next.

    Appends integers and does nothing else, so that it can stay in the hot loop.
    """

    def __init__(self) -> None:
        self._laps: dict[str, array[int]] = {}
        self._cycles = array("q")
        self._started_ns = 0
        self._lap_ns = 0

    def start(self, received_ns: int) -> None:
        """Begin a cycle whose input arrived at `received_ns` (monotonic clock)."""
        self._started_ns = received_ns
        self._lap_ns = time.monotonic_ns()

    def lap(self, stage: str) -> None:
        """The time since the last lap, or the start, belonged to `stage`."""
        now = time.monotonic_ns()
        if stage not in self._laps:
            self._laps[stage] = array("q")
        self._laps[stage].append(now - self._lap_ns)
        self._lap_ns = now

    def stop(self) -> None:
        """End the cycle."""
        self._cycles.append(time.monotonic_ns() - self._started_ns)

    @property
    def cycles(self) -> int:
        return len(self._cycles)

    def cycle_percentiles_ms(self) -> dict[str, float]:
        """From arrival of the state to the chunk on the wire, ms."""
        return percentiles_ms(self._cycles)

    def stage_percentiles_ms(self) -> dict[str, dict[str, float]]:
        """The same for each stage."""
        return {stage: percentiles_ms(laps) for stage, laps in self._laps.items()}


def percentiles_ms(durations_ns: Sequence[int]) -> dict[str, float]:
    """p50, p99, p99.9 and the maximum of durations, ms; zeros of none."""
    if not durations_ns:
        return {"p50": 0.0, "p99": 0.0, "p99.9": 0.0, "max": 0.0}
    values = np.array(durations_ns) / 1e6
    p50, p99, p999 = np.percentile(values, (50.0, 99.0, 99.9))
    return {"p50": float(p50), "p99": float(p99), "p99.9": float(p999), "max": float(values.max())}
