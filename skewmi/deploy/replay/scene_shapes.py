"""The shapes around the robot, each under its joint; a joint's entity carries the motion.

A simulated scene may stand elsewhere than described: its robot tells where, and so it is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from skewmi.deploy.replay.data import Placement, Series, rotation_of
from skewmi.deploy.replay.style import Array, Canvas
from skewmi.deploy.wire.scene_geometry import SceneGeometry, SceneJoint
from skewmi.deploy.wire.simulation_status import ScenePose

_HERE = ScenePose((), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))


class SceneView:
    """Boxes of a scene, and what moves them.

    Args:
        canvas: Where to draw.
        geometry: The shapes.
    """

    def __init__(self, canvas: Canvas, geometry: SceneGeometry) -> None:
        self._canvas, self._geometry = canvas, geometry
        self._placements: tuple[Placement, ...] = ()
        """The newest one before the present stretch, and those in it."""
        self._last = {joint.name: 0.0 for joint in geometry.joints}
        self._moved: set[str] = set()
        for part in geometry.parts:
            canvas.style(
                part_path(part.joint, part.name),
                rr.Boxes3D(
                    half_sizes=[part.half_size],
                    centers=[part.position],
                    quaternions=[rr.Quaternion(xyzw=np.roll(part.quaternion_wxyz, -1))],
                    colors=[part.colour],
                    fill_mode="solid",
                ),
            )

    def draw(self, states: Series, placements: Sequence[Placement] = ()) -> None:
        """Move the scene's joints, and the whole of it.

        Args:
            states: Positions of the scene's joints.
            placements: Where the scene stands from when on; only changes.
        """
        self._placements = (*self._placements[-1:], *placements)
        for placement in placements:
            self._place_fixed(placement)
        for joint in self._geometry.joints:
            self._draw_joint(joint, states, placements)

    def _place_fixed(self, placement: Placement) -> None:
        """Put what has no joint where it stands from now on."""
        for part in self._geometry.parts:
            pose = _pose_of(part.name, placement.poses)
            if part.joint or (pose == _HERE and part.name not in self._moved):
                continue
            self._moved.add(part.name)
            there = rr.Transform3D.columns(
                translation=np.array([pose.translation]),
                quaternion=np.roll(pose.quaternion_wxyz, -1)[None],
            )
            self._canvas.columns(part_path("", part.name), np.array([placement.time_s]), there)

    def _draw_joint(
        self, joint: SceneJoint, states: Series, placements: Sequence[Placement]
    ) -> None:
        times, values = np.zeros(0), np.zeros(0)
        if joint.name in states.names:
            times, values = states.time_s, states.values[:, states.names.index(joint.name)]
        # A scene that is moved is moved at once, whenever its joints are told next.
        moved_s = np.array([placement.time_s for placement in placements])
        known = np.append(self._last[joint.name], values)
        moved = known[np.searchsorted(times, moved_s, side="right")]
        order = np.argsort(np.append(moved_s, times), kind="stable")
        times, values = np.append(moved_s, times)[order], np.append(moved, values)[order]
        if not len(times):
            return
        self._last[joint.name] = float(values[-1])
        name = next((p.name for p in self._geometry.parts if p.joint == joint.name), "")
        since = np.array([placement.time_s for placement in self._placements])
        at = np.searchsorted(since, times, side="right") - 1
        columns = np.empty((len(times), 3)), np.empty((len(times), 4))
        for index in np.unique(at):
            poses = self._placements[index].poses if index >= 0 else ()
            rows = at == index
            columns[0][rows], columns[1][rows] = _moved(joint, values[rows], _pose_of(name, poses))
        translation, quaternion = columns
        self._canvas.columns(
            f"/world/scene/{joint.name}",
            times,
            rr.Transform3D.columns(
                translation=translation, quaternion=np.roll(quaternion, -1, axis=1)
            ),
        )


def part_path(joint: str, name: str) -> str:
    """Entity of a part."""
    return f"/world/scene/{joint or 'fixed'}/{name}"


def _pose_of(part: str, poses: Sequence[ScenePose]) -> ScenePose:
    return next((pose for pose in poses if part in pose.parts), _HERE)


def _moved(joint: SceneJoint, values: Array, pose: ScenePose) -> tuple[Array, Array]:
    """Where a joint has put what it carries, in a scene that stands where `pose` says.

    Returns:
        Translation, m, shape (n, 3), and quaternion wxyz, shape (n, 4): p' = R p + t.
    """
    axis, anchor = np.array(joint.axis), np.array(joint.anchor)
    if joint.kind == "slide":
        translation = values[:, None] * axis
        quaternion = np.tile((1.0, 0.0, 0.0, 0.0), (len(values), 1))
    else:
        # p' = R (p - anchor) + anchor
        half = values / 2
        vector = np.sin(half)[:, None] * axis
        quaternion = np.column_stack([np.cos(half), vector])
        turned = anchor + 2 * np.cross(
            vector, np.cross(vector, anchor) + np.cos(half)[:, None] * anchor
        )
        translation = anchor - turned
    translation = translation @ rotation_of(pose.quaternion_wxyz).T + np.array(pose.translation)
    return translation, _product(np.array(pose.quaternion_wxyz), quaternion)


def _product(first: Array, others: Array) -> Array:
    """Quaternion of turning by each of `others` (n, 4) and then by `first` (4,), wxyz."""
    w, x, y, z = first
    matrix = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    product: Array = others @ matrix.T
    return product
