"""Curves of when things were sent, and of what the robot server counts as gone wrong."""

from __future__ import annotations

from skewmi.deploy.replay.data import Run
from skewmi.deploy.replay.style import COMMANDED, JOINT_COLORS, LIMIT, MEASURED, OTHER, Canvas
from skewmi.deploy.replay.timing import REGULAR, interval_path

_COLORS = (COMMANDED, MEASURED, OTHER)
"""Of commands, joint states and the robot's cycles."""
_COUNT_COLORS = (JOINT_COLORS[0], JOINT_COLORS[1], OTHER, JOINT_COLORS[6])


def draw_timing(canvas: Canvas, run: Run) -> None:
    """Draw a stretch of the run."""
    for kind, color in zip(REGULAR, _COLORS, strict=True):
        series = run.intervals.get(kind.label)
        if series is not None:
            path = interval_path(kind.label)
            canvas.curves(f"{path}/ms", series.time_s, series.values, series.names, (color,))
            words = f"meant: {kind.period_ms:g} ms"
            canvas.bounds(f"{path}/meant", series.time_s, [kind.period_ms], [words], [LIMIT])
    spare = run.spare
    canvas.curves("/timing/spare/ms", spare.time_s, spare.values, spare.names, (COMMANDED,))
    canvas.bounds("/timing/spare/late", spare.time_s, [0.0], ["below: too late"], [LIMIT])
    counts = run.counts
    canvas.curves("/timing/counts", counts.time_s, counts.values, counts.names, _COUNT_COLORS)
