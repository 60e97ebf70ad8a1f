"""Curves of the task: the scene's joints, what success needs of them, what the policy does."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from skewmi.deploy.replay.data import Run, Subject
from skewmi.deploy.replay.style import BOX, LIMIT, SCENE_COLORS, Canvas, field_color
from skewmi.policy_io import PolicyLayout

_PULSE_S = 0.3
_UNITS = {"hinge": ("deg", 180.0 / math.pi), "slide": ("mm", 1e3)}


@dataclass(frozen=True)
class SceneCurve:
    """How a joint of the scene is drawn."""

    name: str
    unit: str
    scale: float
    """Units per rad or m."""
    thresholds: tuple[tuple[float, str], ...]
    """What success needs: value in the unit, and words."""
    color: tuple[int, ...]

    @property
    def title(self) -> str:
        """Of its plot."""
        words = "".join(f", {words}" for _, words in self.thresholds)
        return f"{self.name} [{self.unit}]{words}"


def scene_curves(subject: Subject, names: tuple[str, ...]) -> tuple[SceneCurve, ...]:
    """Of all joints that the scene's states name."""
    joints = () if subject.geometry is None else subject.geometry.joints
    known = {joint.name: joint for joint in joints}
    found = []
    for index, name in enumerate(names):
        joint = known.get(name)
        unit, scale = ("rad or m", 1.0) if joint is None else _UNITS[joint.kind]
        thresholds = () if joint is None else _thresholds(subject.layout, joint.field, unit, scale)
        color = SCENE_COLORS[index % len(SCENE_COLORS)]
        found.append(SceneCurve(name, unit, scale, thresholds, color))
    return tuple(found)


def _thresholds(
    layout: PolicyLayout | None, field: str, unit: str, scale: float
) -> tuple[tuple[float, str], ...]:
    """Bounds of the reward region on one field, those beyond its range left out."""
    ranges = {} if layout is None else {f.name: (f.low, f.high) for f in layout.observation}
    if layout is None or field not in ranges:
        return ()
    low, high = ranges[field]
    found = []
    for ball in layout.reward_region:
        if ball.fields == (field,):
            least, most = ball.centre[0] - ball.radius, ball.centre[0] + ball.radius
            if least > low:
                found.append((scale * least, f"success from {scale * least:.4g} {unit}"))
            if most < high:
                found.append((scale * most, f"success up to {scale * most:.4g} {unit}"))
    return tuple(found)


class TaskCurves:
    """Draws them.

    Args:
        canvas: Where to draw.
        subject: What is known of the run.
    """

    def __init__(self, canvas: Canvas, subject: Subject) -> None:
        self._canvas, self._subject = canvas, subject
        joints = () if subject.geometry is None else subject.geometry.joints
        self._scene_fields = tuple(joint.field for joint in joints)

    def draw(self, run: Run) -> None:
        """Draw a stretch of the run."""
        self._draw_scene(run)
        self._draw_observation(run)
        self._draw_success(run)
        action = run.action
        if action.names:
            path = "/policy/action"
            self._canvas.curves(
                f"{path}/fields", action.time_s, action.values, action.names,
                self._colors(action.names),
            )  # fmt: skip
            self._canvas.bounds(f"{path}/range", action.time_s, (-1.0, 1.0))

    def _colors(self, names: tuple[str, ...]) -> tuple[tuple[int, ...], ...]:
        return tuple(field_color(name, self._scene_fields) for name in names)

    def _draw_scene(self, run: Run) -> None:
        for index, curve in enumerate(scene_curves(self._subject, run.scene.names)):
            values = curve.scale * run.scene.values[:, index : index + 1]
            path, time_s = f"/scene_joints/{curve.name}", run.scene.time_s
            self._canvas.curves(f"{path}/value", time_s, values, (curve.name,), (curve.color,))
            self._canvas.bounds(
                f"{path}/success",
                time_s,
                [value for value, _ in curve.thresholds],
                [words for _, words in curve.thresholds],
                [LIMIT] * len(curve.thresholds),
            )

    def _draw_observation(self, run: Run) -> None:
        observation, layout = run.observation, self._subject.layout
        if not observation.names:
            return
        names, time_s, in_range = observation.names, observation.time_s, observation.values
        colors = self._colors(names)
        self._canvas.curves("/policy/observation", time_s, in_range, names, colors)
        if layout is not None and layout.observation_names == names:
            low, high = layout.observation_low, layout.observation_high
            in_range = (in_range - low) / (high - low)
        path = "/policy/observation_in_range/fields"
        self._canvas.curves(path, time_s, in_range, names, colors)

    def _draw_success(self, run: Run) -> None:
        # A pulse at each success; a single instant would vanish between two pixels.
        edges = np.array([(t - 1e-3, t, t + _PULSE_S, t + _PULSE_S + 1e-3) for t in run.success_s])
        heights = np.tile([[0.0], [1.0], [1.0], [0.0]], (len(edges), 1))
        self._canvas.curves(
            "/policy/observation_in_range/success",
            edges.ravel(),
            heights,
            ("success",),
            (BOX[:3],),
            aggregated=False,
        )
