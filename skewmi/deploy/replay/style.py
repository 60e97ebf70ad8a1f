"""What all parts of a view share: the time axis, the colors, and how curves are drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

Array = NDArray[np.float64]

TIMELINE = "robot_time"
"""Seconds of the robot server's clock since the recording's first stamp."""

COMMANDED = (255, 140, 30, 255)
MEASURED = (60, 160, 255, 255)
BOX = (90, 200, 120, 160)
LIMIT = (150, 150, 150, 255)
JOINT_COLORS = (
    (230, 75, 60, 255),
    (245, 165, 35, 255),
    (200, 200, 60, 255),
    (80, 185, 90, 255),
    (70, 190, 210, 255),
    (90, 120, 235, 255),
    (190, 100, 220, 255),
)


def at(time_s: Array) -> list[Any]:
    """Index of columns: seconds on the time axis. Shape (n,)."""
    return [rr.TimeColumn(TIMELINE, duration=time_s)]


class Canvas:
    """A Rerun recording, and what has been drawn on it for good.

    Looks (names, colors, widths) are logged once, with the first data of their entity; the data
    goes out in whole columns, one call per entity and stretch. Logging sample by sample would cost
    a millisecond each.

    Args:
        recording: A `rerun.RecordingStream`.
    """

    def __init__(self, recording: Any) -> None:
        self.recording = recording
        self._styled: set[str] = set()

    def style(self, path: str, look: Any) -> None:
        """Log a look the first time it is asked for."""
        if path not in self._styled:
            self._styled.add(path)
            self.recording.log(path, look, static=True)

    def columns(self, path: str, time_s: Array, columns: Any) -> None:
        """Send columns of an archetype; nothing if there is no time."""
        if len(time_s):
            self.recording.send_columns(path, indexes=at(time_s), columns=columns)

    def curves(
        self,
        path: str,
        time_s: Array,
        values: Array,
        names: tuple[str, ...],
        colors: tuple[tuple[int, ...], ...],
        *,
        aggregated: bool = True,
    ) -> None:
        """Several curves on one entity: one column. Shape of values (n, len(names))."""
        if not len(time_s):
            return
        # Zoomed out, a pixel shows the extremes: the default average would hide peaks.
        policy = rr.components.AggregationPolicy
        look = rr.SeriesLines(
            names=names,
            colors=colors,
            widths=[1.5] * len(names),
            aggregation_policy=policy.MinMax if aggregated else policy.Off,
        )
        self.style(path, look)
        self.columns(path, time_s, rr.Scalars.columns(scalars=values))

    def bounds(self, path: str, time_s: Array, bounds: tuple[float, float]) -> None:
        """Two horizontal lines for as long as there are times."""
        if not len(time_s):
            return
        names, colors = ["limit", "limit"], [LIMIT] * 2
        self.style(path, rr.SeriesLines(names=names, colors=colors, widths=[1.0] * 2))
        ends = np.array([time_s[0], time_s[-1]])
        self.columns(path, ends, rr.Scalars.columns(scalars=np.array([bounds, bounds])))
