"""What all parts of a replay share: the time axis and the colours."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

Array = NDArray[np.float64]

TIMELINE = "robot_time"
"""Seconds of the endpoint's clock since the recording's first stamp."""

COMMANDED = (255, 140, 30, 255)
MEASURED = (60, 160, 255, 255)
BOX = (90, 200, 120, 160)
LIMIT = (150, 150, 150, 255)
JOINT_COLOURS = (
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
