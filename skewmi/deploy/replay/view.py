"""Draws a run in Rerun: robot and scene moving, curves against limits, events, layout.

A replay draws one stretch, a live view one after the other.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import rerun as rr

from skewmi.deploy.replay.blueprint import TRAIL_S, blueprint
from skewmi.deploy.replay.data import Motion, Run, Subject
from skewmi.deploy.replay.scene import PathView, RobotView, SceneView
from skewmi.deploy.replay.style import BOX, JOINT_COLORS, TIMELINE, Array, Canvas
from skewmi.smoothness import bands
from skewmi.trajectory import GRID_S

_JOINT_LABELS = tuple(f"joint {number}" for number in (1, 2, 7, 3, 4, 5, 6))
_AXES = ("x", "y", "z")
_AXIS_COLORS = (JOINT_COLORS[0], JOINT_COLORS[3], JOINT_COLORS[5])
_PULSE_S = 0.3
SPECTRUM_HZ = 30
"""Highest frequency that is drawn by itself; the last bar is all above."""
_SPECTRUM_SAMPLES = round(TRAIL_S / GRID_S)
_LEVELS = {0: "INFO", 1: "WARN", 2: "ERROR"}


class RunView:
    """Everything of a run, and the blueprint.

    Args:
        recording: A `rerun.RecordingStream`.
        subject: What is known of the run.
        title: Name of the 3D view.
        live: The run is under way: follow it, and show what was lately.
    """

    def __init__(self, recording: Any, subject: Subject, title: str, *, live: bool = False) -> None:
        self._recording, self._subject, self._title, self._live = recording, subject, title, live
        canvas = self._canvas = Canvas(recording)
        canvas.style("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        layout = subject.layout
        self._workspace = None if layout is None else layout.workspace
        self._measured = RobotView(canvas, "measured", ghost=False)
        self._commanded = RobotView(canvas, "commanded", ghost=True)
        self._paths = PathView(canvas, self._workspace, trail=live)
        self._scene = None if subject.geometry is None else SceneView(canvas, subject.geometry)
        self._commanding = False
        self._accelerations: Array = np.zeros((0, len(_JOINT_LABELS)))
        self._laid_out: tuple[bool, tuple[str, ...]] | None = None

    def draw(self, run: Run) -> None:
        """Draw a stretch of the run."""
        self._lay_out(run)
        self._measured.draw(run.measured, run.fingers)
        self._measured.draw_left(run.left)
        self._draw_ghost(run)
        self._paths.draw(run)
        if self._scene is not None:
            self._scene.draw(run.scene)
        self._draw_joints(run)
        self._draw_spectrum(run)
        self._draw_hand(run)
        self._draw_policy(run)
        self._draw_scene_joints(run)
        self._draw_events(run)

    def _draw_ghost(self, run: Run) -> None:
        """The arm as commanded; until the first command, the measured one hides it."""
        motion = run.commanded
        if not self._commanding:
            self._commanding = len(motion.time_s) > 0
            held = run.measured.time_s < (motion.time_s[0] if self._commanding else math.inf)
            nothing = run.measured.q[held, :0]
            motion = Motion(
                np.concatenate([run.measured.time_s[held], motion.time_s]),
                np.concatenate([run.measured.q[held], motion.q]),
                *[nothing] * 3,
            )
        self._commanded.draw(motion, run.fingers)

    def _lay_out(self, run: Run) -> None:
        """Send the blueprint; again only if something new is to be seen."""
        policy = bool(run.observation.names) or (self._live and self._subject.layout is not None)
        shown = policy, run.scene.names
        if shown != self._laid_out:
            self._laid_out = shown
            self._recording.send_blueprint(
                blueprint(self._title, policy=policy, scene=run.scene.names, live=self._live)
            )

    def _draw_joints(self, run: Run) -> None:
        """Position, velocity, acceleration and jerk of each joint, as fractions of its limits."""
        motion, limits = run.commanded, self._subject.limits
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
                f"{path}/of_limit", motion.time_s, values, _JOINT_LABELS, JOINT_COLORS
            )
            self._canvas.bounds(f"{path}/limit", motion.time_s, (-1.0, 1.0))

    def _draw_spectrum(self, run: Run) -> None:
        """At which frequencies the joints are accelerated, so far or lately: bars of 1 Hz."""
        if not len(run.commanded.time_s):
            return
        lately = np.concatenate([self._accelerations, run.commanded.a])
        self._accelerations = lately[-_SPECTRUM_SAMPLES:] if self._live else lately
        percent = 100.0 * bands(self._accelerations, GRID_S, SPECTRUM_HZ)
        self._recording.set_time(TIMELINE, duration=float(run.commanded.time_s[-1]))
        middles = np.arange(SPECTRUM_HZ + 1) + 0.5
        self._recording.log("/joints/spectrum", rr.BarChart(percent, abscissa=middles))

    def _draw_hand(self, run: Run) -> None:
        """Hand coordinates as fractions of the workspace box, and how far it lags."""
        workspace = self._workspace
        for name, motion in (("commanded", run.commanded), ("measured", run.measured)):
            if workspace is not None and len(motion.time_s):
                low, high = np.array(workspace.low), np.array(workspace.high)
                inside = (motion.hand_w - (low + high) / 2) / ((high - low) / 2)
                path = f"/hand/{name}"
                self._canvas.curves(f"{path}/in_box", motion.time_s, inside, _AXES, _AXIS_COLORS)
                self._canvas.bounds(f"{path}/box", motion.time_s, (-1.0, 1.0))
        error = run.error
        self._canvas.curves("/hand/error/mm", error.time_s, 1e3 * error.values, _AXES, _AXIS_COLORS)

    def _draw_policy(self, run: Run) -> None:
        observation, action, layout = run.observation, run.action, self._subject.layout
        if observation.names:
            names, time_s, in_range = observation.names, observation.time_s, observation.values
            colors = tuple(JOINT_COLORS[i % 7] for i in range(len(names)))
            self._canvas.curves("/policy/observation", time_s, in_range, names, colors)
            if layout is not None and layout.observation_names == names:
                low, high = layout.observation_low, layout.observation_high
                in_range = (in_range - low) / (high - low)
            path = "/policy/observation_in_range"
            self._canvas.curves(f"{path}/fields", time_s, in_range, names, colors)
            # A pulse at each success; a single instant would vanish between two pixels.
            edges = np.array(
                [(t - 1e-3, t, t + _PULSE_S, t + _PULSE_S + 1e-3) for t in run.success_s]
            )
            heights = np.tile([[0.0], [1.0], [1.0], [0.0]], (len(edges), 1))
            self._canvas.curves(
                f"{path}/success",
                edges.ravel(),
                heights,
                ("success",),
                (BOX[:3],),
                aggregated=False,
            )
        if action.names:
            colors = tuple(JOINT_COLORS[i % 7] for i in range(len(action.names)))
            self._canvas.curves(
                "/policy/action/fields", action.time_s, action.values, action.names, colors
            )
            self._canvas.bounds("/policy/action/range", action.time_s, (-1.0, 1.0))

    def _draw_scene_joints(self, run: Run) -> None:
        for index, name in enumerate(run.scene.names):
            self._canvas.curves(
                f"/scene_joints/{name}/value",
                run.scene.time_s,
                run.scene.values[:, index : index + 1],
                (name,),
                (JOINT_COLORS[index % 7],),
            )

    def _draw_events(self, run: Run) -> None:
        events = []
        for time_s, status in run.events:
            refusal = status.values.get("refusal")
            text = f"refused: {refusal}" if refusal else status.message
            events.append((time_s, f"{status.name}: {text}", _LEVELS.get(status.level, "ERROR")))
        events += [(time_s, "success: reward region held", "INFO") for time_s in run.success_s]
        events = [event for event in sorted(events) if math.isfinite(event[0])]
        if events:
            times, texts, levels = zip(*events, strict=True)
            columns = rr.TextLog.columns(text=texts, level=levels)
            self._canvas.columns("/events", np.array(times), columns)
