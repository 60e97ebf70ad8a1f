"""The scene of a replay."""

from __future__ import annotations

import mujoco
import numpy as np
from recorded_motion import SCENE
from rerun.chunk import RrdReader

from skewmi.deploy.replay.replay import write_replay
from skewmi.deploy.robot.backends.mujoco.scene_geometry import scene_geometry
from skewmi.deploy.wire.scene_geometry import SceneGeometry


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
