"""What all parts of a view share: the time axis, the colors, and how curves are drawn."""

from __future__ import annotations

from collections.abc import Sequence
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
"""Of the arm's joints, in chain order."""
AXIS_COLORS = ((230, 75, 60, 255), (80, 185, 90, 255), (90, 120, 235, 255))
"""Of x, y and z."""
SCENE_COLORS = ((235, 130, 190, 255), (240, 205, 70, 255), (120, 220, 200, 255))
"""Of the scene's joints, in the order of their description."""
OTHER = (190, 190, 190, 255)

AXES = ("x", "y", "z")
JOINT_LABELS = tuple(f"joint {number}" for number in (1, 2, 7, 3, 4, 5, 6))
"""In chain order."""


def dimmed(color: tuple[int, ...]) -> tuple[int, ...]:
    """The same color for what belongs to a curve and is none: its limits."""
    return (*(round(0.55 * part) for part in color[:3]), 255)


def field_color(name: str, scene_fields: Sequence[str]) -> tuple[int, ...]:
    """Color of a number of an observation or action, the same wherever it is drawn.

    Args:
        name: Of the number: what ends with _x, _y or _z, or is called vx and so on, lies along an
            axis.
        scene_fields: Observation fields of the scene's joints, in the order of their description.
    """
    if name in scene_fields:
        return SCENE_COLORS[list(scene_fields).index(name) % len(SCENE_COLORS)]
    tail = name[-1:]
    if tail in AXES and (len(name) <= 2 or name[-2] in "_ "):
        return AXIS_COLORS[AXES.index(tail)]
    return OTHER


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
        if path not in self._styled:
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

    def bounds(
        self,
        path: str,
        time_s: Array,
        bounds: Sequence[float],
        names: Sequence[str] = (),
        colors: Sequence[tuple[int, ...]] = (),
    ) -> None:
        """Horizontal lines for as long as there are times; grey and called "limit" by default."""
        if not len(time_s) or not len(bounds):
            return
        if path not in self._styled:
            names = names or ["limit"] * len(bounds)
            colors = colors or [LIMIT] * len(bounds)
            look = rr.SeriesLines(names=names, colors=colors, widths=[1.0] * len(bounds))
            self.style(path, look)
        ends = np.array([time_s[0], time_s[-1]])
        self.columns(path, ends, rr.Scalars.columns(scalars=np.array([bounds, bounds])))
