"""Draws a run in Rerun: robot and scene moving, curves against limits, events, legend, layout.

A replay draws one stretch, a live view one after the other.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import rerun as rr

from skewmi.deploy.replay.blueprint import blueprint
from skewmi.deploy.replay.data import Motion, Run, Subject
from skewmi.deploy.replay.hand_curves import HandCurves
from skewmi.deploy.replay.joint_curves import JointCurves
from skewmi.deploy.replay.legend import Legend
from skewmi.deploy.replay.scene import PathView, RobotView
from skewmi.deploy.replay.scene_shapes import SceneView
from skewmi.deploy.replay.style import Canvas
from skewmi.deploy.replay.task_curves import TaskCurves, scene_curves
from skewmi.deploy.replay.timing_curves import draw_timing

_LEVELS = {0: "INFO", 1: "WARN", 2: "ERROR"}
_WHO = {"skewmi_robot": "robot", "skewmi_deploy": "session"}
"""Short names of those who tell their state."""


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
        workspace = None if subject.layout is None else subject.layout.workspace
        self._measured = RobotView(canvas, "measured", subject.base, ghost=False)
        self._commanded = RobotView(canvas, "commanded", subject.base, ghost=True)
        self._paths = PathView(canvas, workspace, trail=live)
        self._scene = None if subject.geometry is None else SceneView(canvas, subject.geometry)
        self._joints = JointCurves(canvas, subject.limits, live=live)
        self._hand = HandCurves(canvas, workspace)
        self._task = TaskCurves(canvas, subject)
        self._legend = Legend(subject, live=live)
        self._legend_text = ""
        self._commanding = False
        self._laid_out: tuple[bool, tuple[str, ...]] | None = None

    def draw(self, run: Run) -> None:
        """Draw a stretch of the run."""
        self._lay_out(run)
        self._measured.draw(run.measured, run.fingers)
        self._measured.draw_left(run.left)
        self._draw_ghost(run)
        self._paths.draw(run)
        if self._scene is not None:
            self._scene.draw(run.scene, run.placements)
        self._joints.draw(run)
        self._hand.draw(run)
        self._task.draw(run)
        draw_timing(self._canvas, run)
        self._draw_events(run)
        self._draw_legend(run)

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
                nothing,
                nothing,
                nothing,
                self._subject.base,
            )
        self._commanded.draw(motion, run.fingers)

    def _lay_out(self, run: Run) -> None:
        """Send the blueprint; again only if something new is to be seen."""
        policy = bool(run.observation.names) or (self._live and self._subject.layout is not None)
        shown = policy, run.scene.names
        if shown != self._laid_out:
            self._laid_out = shown
            scene = {
                curve.name: curve.title for curve in scene_curves(self._subject, run.scene.names)
            }
            self._recording.send_blueprint(
                blueprint(self._title, policy=policy, scene=scene, live=self._live)
            )

    def _draw_events(self, run: Run) -> None:
        """A row for each change of state, refusal and success, under who tells it."""
        events: dict[str, list[tuple[float, str, str]]] = {}
        for time_s, status in run.events:
            refusal = status.values.get("refusal")
            who = _WHO.get(status.name, status.name or "unknown")
            # The viewer's own column of entities is too narrow to read.
            text = f"{who}: " + (f"refused: {refusal}" if refusal else status.message)
            level = _LEVELS.get(status.level, "ERROR")
            events.setdefault(who, []).append((time_s, text, level))
        for time_s in run.success_s:
            events.setdefault("task", []).append(
                (time_s, "task: success, reward region held", "INFO")
            )
        for who, rows in events.items():
            finite = [row for row in sorted(rows) if math.isfinite(row[0])]
            if finite:
                times, texts, levels = zip(*finite, strict=True)
                columns = rr.TextLog.columns(text=texts, level=levels)
                self._canvas.columns(event_path(who), np.array(times), columns)

    def _draw_legend(self, run: Run) -> None:
        """What the colors mean, and what is missing; again only if that is another now."""
        self._legend.see(run)
        text = self._legend.text()
        if text != self._legend_text:
            self._legend_text = text
            document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
            self._recording.log("/legend", document, static=True)


def event_path(who: str) -> str:
    """Entity of what somebody tells."""
    return f"/events/{who.replace('/', '_').replace(' ', '_')}"
