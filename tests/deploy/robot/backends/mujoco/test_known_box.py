"""What the simulated robot tells and measures before a box that is known to stand elsewhere."""

from __future__ import annotations

import json
import threading

import mujoco
import numpy as np
import pytest
from moved_boxes import (
    ORIGIN,
    Displacement,
    base_in_box,
    box_moved,
    calibration_at,
    drawn,
    hand_by_mujoco,
)

from skewmi.cli.egm_flags import task_facts
from skewmi.deploy.robot.backends import BackendOptions, make_backend
from skewmi.deploy.robot.backends.mujoco.scene import MujocoScene
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.robot.run import serve_robot
from skewmi.deploy.robot.workspaces import spaces_of, workspaces_told
from skewmi.deploy.wire.scene_geometry import SceneGeometry
from skewmi.deploy.wire.simulation_status import decode_poses
from skewmi.deploy.wire.transport import TransportConfig
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array
from skewmi.robot_models import limits
from skewmi.robot_models.frames import HAND_DOWN, rotation_from_quaternion, rotation_vector
from skewmi.sim.arm.scene import workspace_of
from skewmi.trajectory import JointPoint

RNG = np.random.default_rng(8)
KNOWN = [drawn(RNG) for _ in range(3)]
LAB = limits.profile("lab")


def simulation(known: Displacement, true: Displacement | None = None) -> ArmSimulation:
    variation = None
    if true is not None:
        values = dict(zip(("x", "y", "yaw_deg"), true, strict=True))
        variation = json.dumps({"box_pose": values})
    return ArmSimulation(variation=variation, box=known)


def in_frame(known: Displacement, point_w: Array) -> Array:
    """A point of the simulation's world in the known box's frame, m. Shape (3,)."""
    seen: Array = (np.linalg.inv(box_moved(known)) @ np.append(point_w, 1.0))[:3]
    return seen


@pytest.mark.parametrize("known", KNOWN)
def test_the_arm_starts_before_the_known_box_in_the_same_pose(known: Displacement) -> None:
    robot = simulation(known)
    position, rotation = hand_by_mujoco(robot.command.q, known)
    np.testing.assert_allclose(position, workspace_of(robot.layout).start, atol=1e-5)
    np.testing.assert_allclose(rotation, HAND_DOWN, atol=1e-5)


@pytest.mark.parametrize("true", [None, (0.01, 0.02, -5.0), "known"])
@pytest.mark.parametrize("known", KNOWN)
def test_every_part_is_told_where_it_is(known: Displacement, true: object) -> None:
    """Described in the known box's frame, and put where it really is by what pictures are told."""
    really = known if true == "known" else true
    robot = simulation(known, really)  # type: ignore[arg-type]
    scene = MujocoScene(robot)
    poses = decode_poses({"scene_poses": scene.poses_json}) or ()
    assert bool(poses) == (true != "known"), "what stands where it is described is not told"
    model = robot.scene.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geometry = SceneGeometry.from_json(scene.shapes_json)
    assert geometry.parts
    for part in geometry.parts:
        centre, turn = np.array(part.position), rotation_from_quaternion(part.quaternion_wxyz)
        for pose in poses:
            if part.name in pose.parts:
                moved = rotation_from_quaternion(pose.quaternion_wxyz)
                centre, turn = moved @ centre + pose.translation, moved @ turn
        geom = data.geom(part.name)
        np.testing.assert_allclose(centre, in_frame(known, geom.xpos), atol=1e-9)
        seen = np.linalg.inv(box_moved(known))[:3, :3] @ geom.xmat.reshape(3, 3)
        np.testing.assert_allclose(turn, seen, atol=1e-9)


def test_the_nominal_description_is_what_it_was() -> None:
    plain, told = MujocoScene(ArmSimulation()), MujocoScene(ArmSimulation(box=(0.0, 0.0, 0.0)))
    assert plain.shapes_json == told.shapes_json
    assert plain.known_box is None
    assert workspaces_told(plain, {}) == workspaces_told(told, {})
    moved = MujocoScene(ArmSimulation(box=KNOWN[0]))
    before = {p.name: p for p in SceneGeometry.from_json(plain.shapes_json).parts}
    after = {p.name: p for p in SceneGeometry.from_json(moved.shapes_json).parts}
    elsewhere = {name for name, part in after.items() if part != before[name]}
    assert elsewhere == {"floor_plate", "work_surface"}, "all else moves with the box"


@pytest.mark.parametrize("known", KNOWN)
def test_workspaces_are_told_from_the_robot_base_on(known: Displacement) -> None:
    scene = MujocoScene(ArmSimulation(box=known))
    told = workspaces_told(scene, spaces_of(scene))
    assert set(told) == {"task", "calibration", "touch"}
    base = base_in_box(known)
    np.testing.assert_allclose(told["task"]["low"], np.array(scene.workspace.low) - base[:3, 3])
    np.testing.assert_allclose(told["task"]["yaw"], np.radians(known[2]))
    assert "yaw" not in told["calibration"]


@pytest.mark.parametrize("known", KNOWN)
def test_tilt_and_way_out_of_the_box_are_measured_against_the_known_box(
    known: Displacement,
) -> None:
    robot = simulation(known)
    q = robot.command.q + np.array([-0.15, 0.0, 0.0, 0.0, 0.02, 0.03, 0.03])
    robot.command = JointPoint(q, np.zeros(7), np.zeros(7))
    worst = tilted = 0.0
    low, high = np.array(robot.spec.arm.low), np.array(robot.spec.arm.high)  # type: ignore[union-attr]
    for _ in range(80):
        robot.step()
        joints = robot.robot_state(0).position[:7]
        position, rotation = hand_by_mujoco(joints, known)
        beyond = np.maximum(np.maximum(low - position, position - high), 0.0)
        worst = max(worst, float(np.linalg.norm(beyond)))
        tilted = max(tilted, float(np.linalg.norm(rotation_vector(rotation.T @ HAND_DOWN))))
    summary = robot.contact.summary()
    assert worst > 1e-3
    # The meter sees the pose that the last step began its forces from: one step of 4 ms apart.
    assert summary["outside_box_mm"] == pytest.approx(1e3 * worst, abs=0.3)
    assert summary["hand_tilt_deg"] == pytest.approx(np.degrees(tilted), abs=0.1)


def test_a_bridge_is_told_the_same_of_the_task_as_a_simulation_knows() -> None:
    for known in KNOWN:
        facts = task_facts("open_press_close", calibration_at(*known))
        scene = MujocoScene(ArmSimulation(box=known))
        assert facts.workspace == scene.workspace
        assert facts.box == scene.known_box
        ours, theirs = (SceneGeometry.from_json(x.shapes_json) for x in (facts, scene))
        assert {part.name: part for part in ours.parts} == {p.name: p for p in theirs.parts}


def test_a_robot_that_has_no_scene_refuses_a_box() -> None:
    stop = threading.Event()
    stop.set()  # else a robot that did not refuse would be served for ever
    config = TransportConfig.for_robot("tcp/127.0.0.1:0")
    with pytest.raises(ConfigurationError, match="'hold' has no scene that can be told"):
        serve_robot(
            "hold",
            BackendOptions(),
            config,
            LAB,
            stop,
            calibration=calibration_at(*KNOWN[0]),
        )


def test_a_box_too_far_away_ends_the_start_of_a_robot() -> None:
    with pytest.raises(ConfigurationError, match="put the box nearer"):
        make_backend("sim", BackendOptions(box=(0.0, 0.06, 0.0)))
    with pytest.raises(ConfigurationError, match="without that section"):
        make_backend("sim", BackendOptions("door_open", box=(*ORIGIN, 0.0)))
