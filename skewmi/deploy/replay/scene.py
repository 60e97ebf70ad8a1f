"""The 3D part of a replay: robot, ghost of the command, scene, paths, workspace box."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import rerun as rr

from skewmi.deploy.recording.scene_geometry import SceneGeometry, SceneJoint
from skewmi.deploy.replay.data import Motion, Run, Series
from skewmi.deploy.replay.style import BOX, COMMANDED, MEASURED, Array, at
from skewmi.robot_models import frames, yumi
from skewmi.robot_models.urdf import build_urdf


def log_robot(recording: Any, name: str, motion: Motion, fingers: Series, *, ghost: bool) -> None:
    """The robot from our URDF; a ghost is the moving arm alone, transparent."""
    if not len(motion.time_s):
        return
    text = build_urdf(arms=("right",)) if ghost else build_urdf()
    if ghost:
        colour = " ".join(f"{c / 255:.3f}" for c in COMMANDED[:3])
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
    recording.send_columns(f"/robot_{name}/joints/{joint}", indexes=at(time_s), columns=columns)


def log_paths(recording: Any, run: Run) -> None:
    """Where the hand went and goes, and the box it may not leave."""
    for name, motion, colour in (
        ("commanded", run.commanded, COMMANDED),
        ("measured", run.measured, MEASURED),
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
            indexes=at(motion.time_s),
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
                colors=[BOX],
                radii=[0.001],
            ),
            static=True,
        )


def log_scene(recording: Any, geometry: SceneGeometry, states: Series) -> None:
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
    recording.send_columns(f"/world/scene/{joint.name}", indexes=at(states.time_s), columns=columns)
