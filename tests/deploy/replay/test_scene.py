"""The scene of a replay."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import mujoco
import numpy as np
import rerun as rr
from recorded_motion import SCENE
from rerun.chunk import RrdReader

from skewmi.deploy.replay.data import Motion, Series, no_motion, no_series
from skewmi.deploy.replay.replay import write_replay
from skewmi.deploy.replay.scene import RobotView
from skewmi.deploy.robot.backends.mujoco.scene_geometry import scene_geometry
from skewmi.deploy.wire.scene_geometry import SceneGeometry
from skewmi.robot_models import yumi
from skewmi.robot_models.base_frame import NOMINAL_BASE


def test_scene_geometry_leaves_out_robot_and_floor_and_moves_as_mujoco_does():
    model = mujoco.MjModel.from_xml_string(SCENE)
    geometry = scene_geometry(model)
    assert SceneGeometry.from_json(geometry.to_json()) == geometry
    assert {part.name: part.joint for part in geometry.parts} == {
        "wall": "",
        "plate": "lid_hinge",
        "knob": "button_slide",
    }
    joints = {joint.name: joint for joint in geometry.joints}
    plate = next(part for part in geometry.parts if part.name == "plate")
    assert plate.colour == (0.0, 0.0, 1.0, 1.0)
    data = mujoco.MjData(model)
    data.joint("lid_hinge").qpos = 0.7
    mujoco.mj_kinematics(model, data)
    hinge = joints["lid_hinge"]
    offset = np.subtract(plate.position, hinge.anchor)
    axis = np.array(hinge.axis)
    turned = (
        np.cos(0.7) * offset
        + np.sin(0.7) * np.cross(axis, offset)
        + (1 - np.cos(0.7)) * axis * (axis @ offset)
    )
    np.testing.assert_allclose(np.add(hinge.anchor, turned), data.geom("plate").xpos, atol=1e-12)


def test_hinge_in_the_file_turns_about_its_axis(recorded, tmp_path):
    """Rerun's rotation and translation together put the plate where MuJoCo puts it."""
    out = tmp_path / "run.rrd"
    write_replay(recorded, out)
    found = [
        chunk.to_record_batch()
        for chunk in RrdReader(out).stream().to_chunks()
        if str(chunk.entity_path) == "/world/scene/lid_hinge" and not chunk.is_static
    ]
    table = {name: column for batch in found for name, column in batch.to_pydict().items()}
    translation = next(v for k, v in table.items() if "translation" in k)
    quaternion = next(v for k, v in table.items() if "quaternion" in k)
    model = mujoco.MjModel.from_xml_string(SCENE)
    geometry = scene_geometry(model)
    plate = next(part for part in geometry.parts if part.name == "plate")
    data = mujoco.MjData(model)
    for row in (0, len(translation) // 2, len(translation) - 1):
        data.joint("lid_hinge").qpos = 0.5 * row * 0.02
        mujoco.mj_kinematics(model, data)
        moved = np.empty(3)
        xyzw = np.array(quaternion[row][0])
        mujoco.mju_rotVecQuat(moved, np.array(plate.position), np.roll(xyzw, 1))
        np.testing.assert_allclose(moved + translation[row][0], data.geom("plate").xpos, atol=1e-6)


def test_fingers_move_in_a_stretch_without_a_command():
    """A live view gets them so between two runs of commands; a replay has one stretch alone."""
    drawn: list[tuple[str, list[float]]] = []
    canvas = SimpleNamespace(
        recording=rr.RecordingStream("fingers"),
        style=lambda entity, *parts: None,
        columns=lambda entity, time_s, columns: drawn.append((entity, list(time_s))),
    )
    view = RobotView(cast(Any, canvas), "commanded", NOMINAL_BASE, ghost=True)
    fingers = Series(np.array([1.0, 1.02]), ("finger",), np.array([[0.01], [0.011]]))
    view.draw(no_motion(), fingers)
    assert not drawn, "there is nothing to move yet"
    nothing = np.zeros((1, 0))
    view.draw(Motion(np.zeros(1), np.zeros((1, 7)), nothing, nothing, nothing), no_series())
    assert len(drawn) == 7
    view.draw(no_motion(), fingers)
    moved = drawn[7:]
    assert {entity.split("/")[-1] for entity, _ in moved} == set(yumi.finger_names("right"))
    assert all(times == [1.0, 1.02] for _, times in moved)
