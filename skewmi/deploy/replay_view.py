"""Logs a run to Rerun: robot and scene moving, curves against limits, events, layout.

Everything goes out in whole columns, one call per entity; logging sample by sample would cost
a millisecond each.
"""

from __future__ import annotations

import math
import re
import tempfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from skewmi.deploy.replay_data import Motion, Run, Series
from skewmi.deploy.scene_geometry import SceneGeometry, SceneJoint
from skewmi.robot_models import frames, yumi
from skewmi.robot_models.urdf import build_urdf

Array = NDArray[np.float64]

TIMELINE = "robot_time"
"""Seconds of the endpoint's clock since the recording's first stamp."""

_COMMANDED = (255, 140, 30, 255)
_MEASURED = (60, 160, 255, 255)
_BOX = (90, 200, 120, 160)
_LIMIT = (150, 150, 150, 255)
_JOINT_COLOURS = (
    (230, 75, 60, 255),
    (245, 165, 35, 255),
    (200, 200, 60, 255),
    (80, 185, 90, 255),
    (70, 190, 210, 255),
    (90, 120, 235, 255),
    (190, 100, 220, 255),
)
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
    _log_robot(recording, "measured", run.measured, run.fingers, ghost=False)
    _log_robot(recording, "commanded", run.commanded, run.fingers, ghost=True)
    _log_paths(recording, run)
    if run.geometry is not None:
        _log_scene(recording, run.geometry, run.scene)
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


def _at(time_s: Array) -> list[Any]:
    return [rr.TimeColumn(TIMELINE, duration=time_s)]


def _log_robot(recording: Any, name: str, motion: Motion, fingers: Series, *, ghost: bool) -> None:
    """The robot from our URDF; a ghost is the moving arm alone, transparent."""
    if not len(motion.time_s):
        return
    text = build_urdf(arms=("right",)) if ghost else build_urdf()
    if ghost:
        colour = " ".join(f"{c / 255:.3f}" for c in _COMMANDED[:3])
        text = re.sub(r'rgba="[^"]*"', f'rgba="{colour} 0.35"', text)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "yumi.urdf"
        file.write_text(text)
        tree = rr.urdf.UrdfTree.from_file_path(
            file,
            entity_path_prefix=f"robot_{name}",  # one path part: Rerun would escape a slash
            frame_prefix=f"{name}/",
            static_transform_entity_path=f"/robot_{name}/tf_static",
        )
        tree.log_urdf_to_recording(recording)
    if not ghost:
        _make_solid(recording, tree, text)
    # The URDF's root is the robot base; world is the frame of everything else here.
    recording.log(
        f"/robot_{name}/base",
        rr.Transform3D(
            translation=frames.BASE_IN_WORLD,
            parent_frame="tf#/",
            child_frame=f"{name}/{yumi.BODY_NAME}",
        ),
        static=True,
    )
    for index, joint in enumerate(yumi.joint_names("right")):
        _log_joint(recording, name, tree, joint, motion.time_s, motion.q[:, index])
    if fingers.names:
        for joint in yumi.finger_names("right"):
            _log_joint(recording, name, tree, joint, fingers.time_s, fingers.values[:, 0])


def _make_solid(recording: Any, tree: Any, text: str) -> None:
    """Fill the shapes, which the URDF importer leaves as wire frames."""
    archetypes = {
        "box": rr.Boxes3D,
        "cylinder": rr.Cylinders3D,
        "capsule": rr.Capsules3D,
        "sphere": rr.Ellipsoids3D,
    }
    for link in ElementTree.fromstring(text).iter("link"):
        shapes = [geometry[0].tag for geometry in link.iterfind("visual/geometry")]
        paths = tree.get_visual_geometry_paths(link.attrib["name"])
        for path, shape in zip(paths, shapes, strict=True):
            solid = archetypes[shape].from_fields(fill_mode=rr.components.FillMode.Solid)
            recording.log(path, solid, static=True)


def _log_joint(
    recording: Any, name: str, tree: Any, joint: str, time_s: Array, values: Array
) -> None:
    found = tree.get_joint_by_name(joint)
    assert found is not None, joint
    columns = found.compute_transform_columns(values, clamp=False)
    recording.send_columns(f"/robot_{name}/joints/{joint}", indexes=_at(time_s), columns=columns)


def _log_paths(recording: Any, run: Run) -> None:
    """Where the hand went and goes, and the box it may not leave."""
    for name, motion, colour in (
        ("commanded", run.commanded, _COMMANDED),
        ("measured", run.measured, _MEASURED),
    ):
        if not len(motion.time_s):
            continue
        hand = motion.hand_w
        recording.log(
            f"/world/path/{name}",
            rr.LineStrips3D([hand[:: max(1, len(hand) // 4000)]], colors=[colour], radii=[0.0008]),
            static=True,
        )
        recording.send_columns(
            f"/world/hand/{name}",
            indexes=_at(motion.time_s),
            columns=rr.Points3D.columns(positions=hand),
        )
        recording.log(
            f"/world/hand/{name}",
            rr.Points3D.from_fields(colors=[colour], radii=[0.005]),
            static=True,
        )
    workspace = run.layout.workspace if run.layout is not None else None
    if workspace is not None:
        recording.log(
            "/world/workspace",
            rr.Boxes3D(
                mins=[workspace.low],
                sizes=[np.subtract(workspace.high, workspace.low)],
                colors=[_BOX],
                radii=[0.001],
            ),
            static=True,
        )


def _log_scene(recording: Any, geometry: SceneGeometry, states: Series) -> None:
    """Each part under its joint; a joint's entity carries the motion."""
    for joint in geometry.joints:
        if joint.name in states.names:
            _log_scene_joint(recording, joint, states)
    for part in geometry.parts:
        recording.log(
            f"/world/scene/{part.joint or 'fixed'}/{part.name}",
            rr.Boxes3D(
                half_sizes=[part.half_size],
                centers=[part.position],
                quaternions=[rr.Quaternion(xyzw=np.roll(part.quaternion_wxyz, -1))],
                colors=[part.colour],
                fill_mode="solid",
            ),
            static=True,
        )


def _log_scene_joint(recording: Any, joint: SceneJoint, states: Series) -> None:
    values = states.values[:, states.names.index(joint.name)]
    axis, anchor = np.array(joint.axis), np.array(joint.anchor)
    if joint.kind == "slide":
        columns = rr.Transform3D.columns(translation=values[:, None] * axis)
    else:
        # p' = R (p - anchor) + anchor
        half = values / 2
        vector = np.sin(half)[:, None] * axis
        quaternion = np.column_stack([vector, np.cos(half)])
        turned = anchor + 2 * np.cross(
            vector, np.cross(vector, anchor) + np.cos(half)[:, None] * anchor
        )
        columns = rr.Transform3D.columns(translation=anchor - turned, quaternion=quaternion)
    recording.send_columns(
        f"/world/scene/{joint.name}", indexes=_at(states.time_s), columns=columns
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
            _JOINT_COLOURS,
        )
        _log_bounds(recording, f"/joints/{name}/limit", motion.time_s, (-1.0, 1.0))


def _log_hand(recording: Any, run: Run) -> None:
    """Hand coordinates as fractions of the workspace box, and how far it lags."""
    colours = (_JOINT_COLOURS[0], _JOINT_COLOURS[3], _JOINT_COLOURS[5])
    workspace = run.layout.workspace if run.layout is not None else None
    for name, motion in (("commanded", run.commanded), ("measured", run.measured)):
        if workspace is not None and len(motion.time_s):
            low, high = np.array(workspace.low), np.array(workspace.high)
            inside = (motion.hand_w - (low + high) / 2) / ((high - low) / 2)
            _log_curves(
                recording, f"/hand/{name}/in_box", motion.time_s, inside, ("x", "y", "z"), colours
            )
            _log_bounds(recording, f"/hand/{name}/box", motion.time_s, (-1.0, 1.0))
    if len(run.commanded.time_s) and len(run.measured.time_s):
        commanded = run.commanded.hand_w
        time_s = run.measured.time_s
        at_measured = np.column_stack(
            [np.interp(time_s, run.commanded.time_s, commanded[:, i]) for i in range(3)]
        )
        error_mm = 1e3 * (at_measured - run.measured.hand_w)
        _log_curves(recording, "/hand/error/mm", time_s, error_mm, ("x", "y", "z"), colours)


def _log_policy(recording: Any, run: Run) -> None:
    observation, action = run.observation, run.action
    if observation.names:
        names = observation.names
        colours = tuple(_JOINT_COLOURS[i % 7] for i in range(len(names)))
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
                recording, f"{path}/success", edges.ravel(), heights, ("success",), (_BOX[:3],)
            )
    if action.names:
        colours = tuple(_JOINT_COLOURS[i % 7] for i in range(len(action.names)))
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
            (_JOINT_COLOURS[index % 7],),
        )


def _log_curves(
    recording: Any,
    path: str,
    time_s: Array,
    values: Array,
    names: tuple[str, ...],
    colours: tuple[tuple[int, ...], ...],
) -> None:
    """Several curves on one entity: one column."""
    recording.log(
        path, rr.SeriesLines(names=names, colors=colours, widths=[1.5] * len(names)), static=True
    )
    recording.send_columns(path, indexes=_at(time_s), columns=rr.Scalars.columns(scalars=values))


def _log_bounds(recording: Any, path: str, time_s: Array, bounds: tuple[float, float]) -> None:
    """Two horizontal lines."""
    ends = np.array([time_s[0], time_s[-1]])
    recording.log(
        path,
        rr.SeriesLines(names=["limit", "limit"], colors=[_LIMIT] * 2, widths=[1.0] * 2),
        static=True,
    )
    recording.send_columns(
        path, indexes=_at(ends), columns=rr.Scalars.columns(scalars=np.array([bounds, bounds]))
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
            indexes=_at(np.array(times)),
            columns=rr.TextLog.columns(text=texts, level=levels),
        )
