"""Logs a run to Rerun: robot and scene moving, curves against limits, events, layout.

Everything goes out in whole columns, one call per entity; logging sample by sample would cost
a millisecond each.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from skewmi.deploy.replay.data import Run, tracking_error
from skewmi.deploy.replay.scene import log_paths, log_robot, log_scene
from skewmi.deploy.replay.style import BOX, JOINT_COLOURS, LIMIT, TIMELINE, Array, at

_JOINT_LABELS = tuple(f"joint {number}" for number in (1, 2, 7, 3, 4, 5, 6))
_PULSE_S = 0.3
_QUANTITIES = ("position", "velocity", "acceleration", "jerk")
_LEVELS = {0: "INFO", 1: "WARN", 2: "ERROR"}


def log_run(recording: Any, run: Run, title: str) -> None:
    """Log everything of a run, and the blueprint.

    Args:
        recording: A `rerun.RecordingStream`.
        run: What to show.
        title: Name of the 3D view.
    """
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    log_robot(recording, "measured", run.measured, run.fingers, ghost=False)
    log_robot(recording, "commanded", run.commanded, run.fingers, ghost=True)
    log_paths(recording, run)
    if run.geometry is not None:
        log_scene(recording, run.geometry, run.scene)
    _log_joints(recording, run)
    _log_hand(recording, run)
    _log_policy(recording, run)
    _log_events(recording, run)
    recording.send_blueprint(blueprint(run, title))


def blueprint(run: Run, title: str) -> Any:
    """3D view and events on the left, curves in tabs on the right."""
    tabs = [
        rrb.Vertical(
            *(
                rrb.TimeSeriesView(
                    origin=f"/joints/{quantity}",
                    name=f"{quantity} / limit",
                    # One legend is enough: four would cover the curves.
                    plot_legend=rrb.PlotLegend(visible=quantity == _QUANTITIES[0]),
                )
                for quantity in _QUANTITIES
            ),
            row_shares=[3, 2, 2, 2],
            name="joints against limits",
        ),
        rrb.Vertical(
            rrb.TimeSeriesView(origin="/hand/commanded", name="hand in workspace box, commanded"),
            rrb.TimeSeriesView(origin="/hand/measured", name="hand in workspace box, measured"),
            rrb.TimeSeriesView(origin="/hand/error", name="commanded - measured, mm"),
            name="hand against box",
        ),
    ]
    if run.observation.names:
        tabs.append(
            rrb.Vertical(
                rrb.TimeSeriesView(
                    origin="/policy/observation_in_range", name="observation, 0..1 of its range"
                ),
                rrb.TimeSeriesView(origin="/policy/action", name="action"),
                name="policy",
            )
        )
    if run.scene.names:
        tabs.append(
            rrb.Vertical(
                *(
                    rrb.TimeSeriesView(origin=f"/scene_joints/{name}", name=name)
                    for name in run.scene.names
                ),
                name="scene",
            )
        )
    eye = rrb.EyeControls3D(
        position=(0.75, -0.65, 0.65), look_target=(-0.1, -0.03, 0.2), eye_up=(0.0, 0.0, 1.0)
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(
                    origin="/",
                    name=title,
                    contents=[
                        "+ /world/**",
                        *(
                            rule
                            for robot in ("robot_measured", "robot_commanded")
                            for rule in (
                                f"+ /{robot}/**",
                                f"- /{robot}/yumi/collision_geometries/**",
                            )
                        ),
                    ],
                    eye_controls=eye,
                ),
                rrb.TextLogView(origin="/events", name="state machines"),
                row_shares=[3, 1],
            ),
            rrb.Tabs(*tabs, name="curves", active_tab=0),
            column_shares=[5, 4],
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
    )


def _log_joints(recording: Any, run: Run) -> None:
    """Position, velocity, acceleration and jerk of each joint, as fractions of its limits."""
    motion, limits = run.commanded, run.limits
    if not len(motion.time_s):
        return
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
        _log_curves(
            recording,
            f"/joints/{name}/of_limit",
            motion.time_s,
            values,
            _JOINT_LABELS,
            JOINT_COLOURS,
        )
        _log_bounds(recording, f"/joints/{name}/limit", motion.time_s, (-1.0, 1.0))


def _log_hand(recording: Any, run: Run) -> None:
    """Hand coordinates as fractions of the workspace box, and how far it lags."""
    colours = (JOINT_COLOURS[0], JOINT_COLOURS[3], JOINT_COLOURS[5])
    workspace = run.layout.workspace if run.layout is not None else None
    for name, motion in (("commanded", run.commanded), ("measured", run.measured)):
        if workspace is not None and len(motion.time_s):
            low, high = np.array(workspace.low), np.array(workspace.high)
            inside = (motion.hand_w - (low + high) / 2) / ((high - low) / 2)
            _log_curves(
                recording, f"/hand/{name}/in_box", motion.time_s, inside, ("x", "y", "z"), colours
            )
            _log_bounds(recording, f"/hand/{name}/box", motion.time_s, (-1.0, 1.0))
    time_s, error = tracking_error(run)
    if len(time_s):
        _log_curves(recording, "/hand/error/mm", time_s, 1e3 * error, ("x", "y", "z"), colours)


def _log_policy(recording: Any, run: Run) -> None:
    observation, action = run.observation, run.action
    if observation.names:
        names = observation.names
        colours = tuple(JOINT_COLOURS[i % 7] for i in range(len(names)))
        _log_curves(
            recording, "/policy/observation", observation.time_s, observation.values, names, colours
        )
        in_range = observation.values
        if run.layout is not None and run.layout.observation_names == names:
            low, high = run.layout.observation_low, run.layout.observation_high
            in_range = (in_range - low) / (high - low)
        path = "/policy/observation_in_range"
        _log_curves(recording, f"{path}/fields", observation.time_s, in_range, names, colours)
        if run.success_s:
            # A pulse at each success; a single instant would vanish between two pixels.
            edges = np.array(
                [(t - 1e-3, t, t + _PULSE_S, t + _PULSE_S + 1e-3) for t in run.success_s]
            )
            heights = np.tile([[0.0], [1.0], [1.0], [0.0]], (len(edges), 1))
            _log_curves(
                recording,
                f"{path}/success",
                edges.ravel(),
                heights,
                ("success",),
                (BOX[:3],),
                aggregated=False,
            )
    if action.names:
        colours = tuple(JOINT_COLOURS[i % 7] for i in range(len(action.names)))
        _log_curves(
            recording, "/policy/action/fields", action.time_s, action.values, action.names, colours
        )
        _log_bounds(recording, "/policy/action/range", action.time_s, (-1.0, 1.0))
    for index, name in enumerate(run.scene.names):
        _log_curves(
            recording,
            f"/scene_joints/{name}/value",
            run.scene.time_s,
            run.scene.values[:, index : index + 1],
            (name,),
            (JOINT_COLOURS[index % 7],),
        )


def _log_curves(
    recording: Any,
    path: str,
    time_s: Array,
    values: Array,
    names: tuple[str, ...],
    colours: tuple[tuple[int, ...], ...],
    *,
    aggregated: bool = True,
) -> None:
    """Several curves on one entity: one column."""
    # Zoomed out, a pixel shows the extremes: the default average would hide peaks.
    policy = rr.components.AggregationPolicy
    recording.log(
        path,
        rr.SeriesLines(
            names=names,
            colors=colours,
            widths=[1.5] * len(names),
            aggregation_policy=policy.MinMax if aggregated else policy.Off,
        ),
        static=True,
    )
    recording.send_columns(path, indexes=at(time_s), columns=rr.Scalars.columns(scalars=values))


def _log_bounds(recording: Any, path: str, time_s: Array, bounds: tuple[float, float]) -> None:
    """Two horizontal lines."""
    ends = np.array([time_s[0], time_s[-1]])
    recording.log(
        path,
        rr.SeriesLines(names=["limit", "limit"], colors=[LIMIT] * 2, widths=[1.0] * 2),
        static=True,
    )
    recording.send_columns(
        path, indexes=at(ends), columns=rr.Scalars.columns(scalars=np.array([bounds, bounds]))
    )


def _log_events(recording: Any, run: Run) -> None:
    events = [
        (time_s, f"{status.name}: {status.message}", _LEVELS.get(status.level, "ERROR"))
        for time_s, status in run.events
    ]
    events += [(time_s, "success: reward region held", "INFO") for time_s in run.success_s]
    events = [event for event in sorted(events) if math.isfinite(event[0])]
    if events:
        times, texts, levels = zip(*events, strict=True)
        recording.send_columns(
            "/events",
            indexes=at(np.array(times)),
            columns=rr.TextLog.columns(text=texts, level=levels),
        )
