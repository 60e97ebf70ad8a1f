"""A simulated scene is drawn where its robot has it, wherever a variation puts it."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from rerun.chunk import RrdReader

from skewmi.deploy.recording.reader import METADATA_NAME, run_metadata
from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.replay.replay import write_replay
from skewmi.deploy.replay.scene_shapes import part_path
from skewmi.deploy.robot.backends.mujoco.backend import MujocoBackend
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.wire import messages, topics
from skewmi.deploy.wire.messages import JointStates, Status
from skewmi.deploy.wire.scene_geometry import SceneGeometry
from skewmi.deploy.wire.simulation_status import decode_poses

STEP_NS = 20_000_000
VARIATIONS = {
    "open_press_close": "box_pose: {x: [-0.05, 0.05], y: [-0.05, 0.05], yaw_deg: [-20, 20]}",
    "door_open": "door_pose: {x: [-0.05, 0.05], y: [-0.05, 0.05], yaw_deg: [-20, 20]}",
}


def transforms(path: Path, entity: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, s, translations and quaternions wxyz of an entity; identity if it has none."""
    times, translations, quaternions = [], [], []
    for chunk in RrdReader(path).stream().to_chunks():
        if str(chunk.entity_path) == entity and not chunk.is_static:
            table = chunk.to_record_batch().to_pydict()
            times += [time.total_seconds() for time in table["robot_time"]]
            translations += next(v for k, v in table.items() if k.endswith("translation"))
            quaternions += next(v for k, v in table.items() if k.endswith("quaternion"))
    if not times:
        return np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]])
    xyzw = np.array(quaternions, dtype=np.float64).reshape(-1, 4)
    return np.array(times), np.array(translations).reshape(-1, 3), np.roll(xyzw, 1, axis=1)


@pytest.mark.parametrize("task", VARIATIONS)
def test_every_part_is_where_the_simulation_has_it(task: str, tmp_path: Path) -> None:
    """Three episodes of different poses, the scene's joints somewhere in each."""
    file = tmp_path / "variation.yaml"
    file.write_text(VARIATIONS[task])
    backend = MujocoBackend(ArmSimulation(task, variation=str(file)))
    scene, simulation = backend.scene, backend.simulation
    geometry = SceneGeometry.from_json(scene.shapes_json)
    model, data = simulation.scene.model, mujoco.MjData(simulation.scene.model)
    rng, recording, out = np.random.default_rng(0), tmp_path / "run.mcap", tmp_path / "run.rrd"
    expected: list[dict[str, np.ndarray]] = []
    with RecordingWriter(recording) as writer:
        writer.add_metadata(METADATA_NAME, run_metadata(scene=scene.shapes_json))
        for episode in range(3):
            scene.reset(episode)
            stamp_ns = (1 + episode) * STEP_NS
            status = Status(stamp_ns, "skewmi_robot", 0, "holding", dict(backend.told()))
            writer.write(topics.YUMI_STATUS, messages.encode_status(status))
            names = simulation.scene.task.joint_names
            values = np.array([rng.uniform(*model.joint(name).range) for name in names])
            for name, value in zip(names, values, strict=True):
                data.joint(name).qpos = value
            mujoco.mj_kinematics(model, data)
            expected.append({p.name: data.geom(p.name).xpos.copy() for p in geometry.parts})
            nothing = values[:0]
            states = JointStates(stamp_ns, names, values, nothing, nothing)
            writer.write(topics.YUMI_SCENE_STATES, messages.encode_joint_states(states))
            state = simulation.robot_state(0)
            arm = JointStates(stamp_ns, backend.state_names, state.position, nothing, nothing)
            writer.write(topics.YUMI_JOINT_STATES, messages.encode_joint_states(arm))
    write_replay(recording, out)
    moved = 0
    for part in geometry.parts:
        path = part_path(part.joint, part.name)
        times, translations, quaternions = transforms(
            out, path.rpartition("/")[0] if part.joint else path
        )
        for episode, positions in enumerate(expected):
            row = int(np.searchsorted(times, episode * STEP_NS / 1e9 + 1e-6, side="right")) - 1
            drawn = np.empty(3)
            mujoco.mju_rotVecQuat(drawn, np.array(part.position), quaternions[row])
            np.testing.assert_allclose(
                drawn + translations[row], positions[part.name], atol=1e-6, err_msg=part.name
            )
            moved += int(np.linalg.norm(positions[part.name] - part.position) > 1e-3)
    assert moved > len(geometry.parts)


def test_a_nominal_scene_is_told_to_stand_where_it_is_described() -> None:
    backend = MujocoBackend(ArmSimulation("open_press_close"))
    assert decode_poses(backend.told()) == ()
