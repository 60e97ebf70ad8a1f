"""Curves of the arm's joints: motion against its limits, frequencies, torques."""

from __future__ import annotations

import numpy as np
import rerun as rr

from skewmi.deploy.replay.blueprint import TRAIL_S
from skewmi.deploy.replay.data import Run, Series
from skewmi.deploy.replay.style import JOINT_COLORS, JOINT_LABELS, TIMELINE, Array, Canvas
from skewmi.robot_models import yumi
from skewmi.smoothness import bands
from skewmi.trajectory import GRID_S

SPECTRUM_HZ = 30
"""Highest frequency that is drawn by itself; the last bar is all above."""
_SPECTRUM_SAMPLES = round(TRAIL_S / GRID_S)


class JointCurves:
    """Draws them.

    Args:
        canvas: Where to draw.
        limits: Per joint, by name; see `Subject.limits`.
        live: The spectrum is of what was lately, not of everything so far.
    """

    def __init__(self, canvas: Canvas, limits: dict[str, Array], *, live: bool) -> None:
        self._canvas, self._limits, self._live = canvas, limits, live
        self._accelerations: Array = np.zeros((0, len(JOINT_LABELS)))

    def draw(self, run: Run) -> None:
        """Draw a stretch of the run."""
        self._draw_motion(run)
        self._draw_spectrum(run)
        self._draw_torque(run.torque)

    def _draw_motion(self, run: Run) -> None:
        """Position, velocity, acceleration and jerk of each joint, as fractions of its limits."""
        motion, limits = run.commanded, self._limits
        fractions: dict[str, Array] = {}
        if {"position_lower", "position_upper"} <= set(limits):
            middle = (limits["position_lower"] + limits["position_upper"]) / 2
            reach = (limits["position_upper"] - limits["position_lower"]) / 2
            fractions["position"] = (motion.q - middle) / reach
        for name, values in (
            ("velocity", motion.v),
            ("acceleration", motion.a),
            ("jerk", motion.jerk),
        ):
            if name in limits:
                fractions[name] = values / limits[name]
        for name, values in fractions.items():
            path = f"/joints/{name}"
            self._canvas.curves(
                f"{path}/of_limit", motion.time_s, values, JOINT_LABELS, JOINT_COLORS
            )
            self._canvas.bounds(f"{path}/limit", motion.time_s, (-1.0, 1.0))

    def _draw_spectrum(self, run: Run) -> None:
        """At which frequencies the joints are accelerated, so far or lately: bars of 1 Hz."""
        if not len(run.commanded.time_s):
            return
        lately = np.concatenate([self._accelerations, run.commanded.a])
        self._accelerations = lately[-_SPECTRUM_SAMPLES:] if self._live else lately
        percent = 100.0 * bands(self._accelerations, GRID_S, SPECTRUM_HZ)
        self._canvas.recording.set_time(TIMELINE, duration=float(run.commanded.time_s[-1]))
        middles = np.arange(SPECTRUM_HZ + 1) + 0.5
        self._canvas.recording.log("/joints/spectrum", rr.BarChart(percent, abscissa=middles))

    def _draw_torque(self, torque: Series) -> None:
        """What the servos push with, as measured, N m."""
        order = {name: index for index, name in enumerate(yumi.joint_names("right"))}
        labels = tuple(JOINT_LABELS[order[name]] for name in torque.names)
        colors = tuple(JOINT_COLORS[order[name]] for name in torque.names)
        self._canvas.curves("/joints/torque", torque.time_s, torque.values, labels, colors)
