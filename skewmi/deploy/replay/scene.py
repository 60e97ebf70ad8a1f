"""The 3D part of a view: robot, ghost of the command, scene, paths, workspace box."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import rerun as rr

from skewmi.deploy.replay.data import Motion, Run, Series
from skewmi.deploy.replay.style import BOX, COMMANDED, MEASURED, TIMELINE, Array, Canvas
from skewmi.policy_io import Workspace
from skewmi.robot_models import yumi
from skewmi.robot_models.base_frame import BaseFrame
from skewmi.robot_models.urdf import build_urdf

_JUMP = 0.03
"""m; between two samples the hand moves 5 mm at most."""


class RobotView:
    """The robot from our URDF, moving; a ghost is the moving arm alone, transparent.

    Args:
        canvas: Where to draw.
        name: What it shows; part of its entities' paths.
        base: Where it stands in the task's frame.
        ghost: See above.
    """

    def __init__(self, canvas: Canvas, name: str, base: BaseFrame, *, ghost: bool) -> None:
        self._canvas, self._name, self._ghost = canvas, name, ghost
        self._base = base
        self._tree: Any = None

    def draw(self, motion: Motion, fingers: Series) -> None:
        """Move the robot; its shapes are logged with the first motion.

        Fingers go on where the arm does not: a live view's stretch may be without a command.
        """
        if len(motion.time_s):
            self._lay_out()
            for index, joint in enumerate(yumi.joint_names("right")):
                self._turn(joint, motion.time_s, motion.q[:, index])
        if self._tree is not None and fingers.names:
            for joint in yumi.finger_names("right"):
                self._turn(joint, fingers.time_s, fingers.values[:, 0])

    def draw_left(self, left: Series) -> None:
        """Move the left arm as measured; until then it hangs where simulation and guard have it."""
        if len(left.time_s):
            self._lay_out()
            for index, joint in enumerate(left.names):
                self._turn(joint, left.time_s, left.values[:, index])

    def _lay_out(self) -> None:
        """Log the shapes, once."""
        if self._tree is not None:
            return
        self._tree = _log_shapes(self._canvas.recording, self._name, self._base, ghost=self._ghost)
        if not self._ghost:
            for joint, value in zip(yumi.joint_names("left"), yumi.HOME["left"], strict=True):
                found = self._tree.get_joint_by_name(joint)
                assert found is not None, joint
                self._canvas.style(
                    f"/robot_{self._name}/joints/{joint}", found.compute_transform(value)
                )

    def _turn(self, joint: str, time_s: Array, values: Array) -> None:
        found = self._tree.get_joint_by_name(joint)
        assert found is not None, joint
        columns = found.compute_transform_columns(values, clamp=False)
        self._canvas.columns(f"/robot_{self._name}/joints/{joint}", time_s, columns)


def _log_shapes(recording: Any, name: str, base: BaseFrame, *, ghost: bool) -> Any:
    """Shapes and frames of the robot; the URDF's tree."""
    text = build_urdf(arms=("right",)) if ghost else build_urdf()
    if ghost:
        color = " ".join(f"{c / 255:.3f}" for c in COMMANDED[:3])
        text = re.sub(r'rgba="[^"]*"', f'rgba="{color} 0.35"', text)
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
            translation=base.position,
            mat3x3=None if base.yaw == 0.0 else base.rotation,
            parent_frame="tf#/",
            child_frame=f"{name}/{yumi.BODY_NAME}",
        ),
        static=True,
    )
    return tree


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


class PathView:
    """Where the hand went and goes, and the box it may not leave.

    Args:
        canvas: Where to draw.
        workspace: The box, if known.
        trail: Draw each stretch of the path at its time, so that a view can show the latest
            ones; else the first stretch is the path and always visible.
    """

    def __init__(self, canvas: Canvas, workspace: Workspace | None, *, trail: bool) -> None:
        self._canvas, self._trail = canvas, trail
        self._ends: dict[str, Array] = {}
        if workspace is not None:
            canvas.style(
                "/world/workspace",
                rr.Boxes3D(
                    mins=[workspace.low],
                    sizes=[np.subtract(workspace.high, workspace.low)],
                    colors=[BOX],
                    radii=[0.001],
                ),
            )

    def draw(self, run: Run) -> None:
        """Move both hands and lengthen their paths."""
        self._draw("commanded", run.commanded, COMMANDED)
        self._draw("measured", run.measured, MEASURED)

    def _draw(self, name: str, motion: Motion, color: tuple[int, ...]) -> None:
        if not len(motion.time_s):
            return
        hand = motion.hand_w
        path = f"/world/hand/{name}"
        self._canvas.style(path, rr.Points3D.from_fields(colors=[color], radii=[0.005]))
        self._canvas.columns(path, motion.time_s, rr.Points3D.columns(positions=hand))
        path = f"/world/path/{name}"
        if not self._trail:
            strip = hand[:: max(1, len(hand) // 4000)]
            self._canvas.style(path, rr.LineStrips3D([strip], colors=[color], radii=[0.0008]))
            return
        strip = np.concatenate([self._ends.get(name, hand[:1]), hand])
        self._ends[name] = hand[-1:]
        # A simulated arm is put elsewhere between episodes: that is no path.
        breaks = np.flatnonzero(np.linalg.norm(np.diff(strip, axis=0), axis=1) > _JUMP) + 1
        strips = [part for part in np.split(strip, breaks) if len(part) > 1]
        if strips:
            self._canvas.recording.set_time(TIMELINE, duration=float(motion.time_s[-1]))
            self._canvas.recording.log(
                path, rr.LineStrips3D(strips, colors=[color], radii=[0.0008])
            )
