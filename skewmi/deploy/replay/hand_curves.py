"""Curves of the hand: where it is in its workspace, how it is tilted, what it pushes against."""

from __future__ import annotations

import numpy as np

from skewmi.contact import QUANTITIES
from skewmi.deploy.replay.data import Motion, Run
from skewmi.deploy.replay.style import (
    AXES,
    AXIS_COLORS,
    COMMANDED,
    LIMIT,
    MEASURED,
    OTHER,
    Canvas,
    dimmed,
)
from skewmi.policy_io import Workspace

MM = 1e3
TILT_LIMIT_DEG = QUANTITIES["hand_tilt_deg"].limit
FORCE_LIMIT_N = QUANTITIES["hand_force_peak_n"].limit


class HandCurves:
    """Draws them.

    Args:
        canvas: Where to draw.
        workspace: What the hand may not leave, and how it is held; None if unknown.
    """

    def __init__(self, canvas: Canvas, workspace: Workspace | None) -> None:
        self._canvas, self._workspace = canvas, workspace

    def draw(self, run: Run) -> None:
        """Draw a stretch of the run."""
        for name, motion, color in (
            ("commanded", run.commanded, COMMANDED),
            ("measured", run.measured, MEASURED),
        ):
            if len(motion.time_s):
                self._draw_position(name, motion)
                self._draw_tilt(name, motion, color)
        if len(run.measured.time_s) and self._workspace is not None and TILT_LIMIT_DEG is not None:
            label = f"gentle: {TILT_LIMIT_DEG:g} deg"
            self._canvas.bounds("/hand/tilt/limit", run.measured.time_s, [TILT_LIMIT_DEG], [label])
        error = run.error
        self._canvas.curves("/hand/error/mm", error.time_s, MM * error.values, AXES, AXIS_COLORS)
        self._draw_forces(run)

    def _draw_position(self, name: str, motion: Motion) -> None:
        """Coordinates in world, mm, and the edges of the workspace."""
        path, hand_mm = f"/hand/{name}", MM * motion.hand_w
        self._canvas.curves(f"{path}/position", motion.time_s, hand_mm, AXES, AXIS_COLORS)
        if self._workspace is not None:
            edges = MM * np.array([self._workspace.low, self._workspace.high])
            names = [f"{axis} {end}" for end in ("low", "high") for axis in AXES]
            colors = [dimmed(color) for color in AXIS_COLORS] * 2
            self._canvas.bounds(
                f"{path}/workspace", motion.time_s, edges.ravel().tolist(), names, colors
            )

    def _draw_tilt(self, name: str, motion: Motion, color: tuple[int, ...]) -> None:
        if self._workspace is not None:
            tilt = motion.tilt_deg(self._workspace.hand_quaternion_wxyz)
            self._canvas.curves(
                f"/hand/tilt/{name}", motion.time_s, tilt[:, None], (name,), (color,)
            )

    def _draw_forces(self, run: Run) -> None:
        forces = run.forces
        self._canvas.curves(
            "/hand/force/contact", forces.time_s, forces.values, forces.names, (MEASURED, OTHER)
        )
        if len(forces.time_s) and FORCE_LIMIT_N is not None:
            label = f"gentle: {FORCE_LIMIT_N:g} N on the hand"
            self._canvas.bounds(
                "/hand/force/limit", forces.time_s, [FORCE_LIMIT_N], [label], [LIMIT]
            )
