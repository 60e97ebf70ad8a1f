"""What a session keeps to outside of the task's workspace agrees with the robot server."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lone_motions import LAB
from moved_boxes import base_in_box
from robot_servers import description

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.backends.mujoco.scene import MujocoScene
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.workspaces import spaces_of, workspaces_told
from skewmi.deploy.safety.checks import SpaceChecks, space_checks
from skewmi.deploy.safety.flange_space import CALIBRATION, TASK, TOUCH, FlangeSpace
from skewmi.deploy.session.open_space import open_space
from skewmi.deploy.session.way_spaces import way_spaces
from skewmi.errors import ConfigurationError, LimitViolationError
from skewmi.policy_io import Array
from skewmi.robot_models import yumi
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.obstacle import Obstacle
from skewmi.trajectory import JointPoint, JointTrajectory

START = np.array(yumi.TABLE_CONFIGURATION)
REST = JointPoint(START, np.zeros(7), np.zeros(7))
EARLIER = np.tile(START, (3, 1))


@pytest.fixture(scope="module")
def told() -> RobotDescription:
    """Of the simulated robot."""
    scene = MujocoScene(ArmSimulation())
    return description(scene=scene.shapes_json, workspaces=workspaces_told(scene, spaces_of(scene)))


def configuration_at(start: Array, higher: float) -> Array:
    """Where the hand is moved straight up, rad. Shape (7,)."""
    arm = ArmKinematics("right")
    position, rotation = arm.forward(start)
    position = position + np.array([0.0, 0.0, higher])
    return np.asarray(arm.inverse(position[None], rotation, start[None], max_iterations=100).q[0])


def judge(checks: SpaceChecks, samples: JointTrajectory) -> None:
    for _, check in checks.stages:
        check(samples, REST, EARLIER)


def test_workspaces_survive_the_wire(told: RobotDescription) -> None:
    assert RobotDescription.from_json(told.to_json()) == told
    for name in (CALIBRATION, TOUCH):
        space = FlangeSpace.from_numbers(name, told.workspaces[name])
        assert space.numbers() == told.workspaces[name]


def test_the_scene_is_an_obstacle_but_for_touching(told: RobotDescription) -> None:
    checks = open_space(told, CALIBRATION, LAB)
    tops = sorted(round(box.top, 3) for box in checks.obstacles)
    assert tops == [0.083, 0.12], "the box's body, and its shut lid with the handle"
    assert open_space(told, TOUCH, LAB).obstacles == ()
    lower = StartMotion(START, configuration_at(START, -0.03), LAB)
    with pytest.raises(LimitViolationError, match="height of the fingers"):
        judge(checks, lower.trajectory)
    with pytest.raises(LimitViolationError, match="to scene at lid_hinge"):
        checks.guard.check(lower.trajectory.q, lower.trajectory.v, lower.trajectory.a)


def test_what_passes_here_passes_the_robot_server(told: RobotDescription) -> None:
    rng = np.random.default_rng(5)
    spaces = {n: FlangeSpace.from_numbers(n, told.workspaces[n]) for n in (CALIBRATION, TOUCH)}
    server = space_checks(LAB, spaces)
    ours = {name: dict(open_space(told, name, LAB).stages)["check"] for name in spaces}
    passed = 0
    for _ in range(60):
        motion = StartMotion(START, START + rng.uniform(-0.5, 0.5, 7), LAB, flange_speed=0.2)
        for name, check in ours.items():
            try:
                check(motion.trajectory, REST, EARLIER)
            except LimitViolationError:
                continue
            server[name](motion.trajectory, REST, EARLIER)
            passed += 1
    assert passed > 5


def test_what_is_not_offered_is_named(told: RobotDescription) -> None:
    with pytest.raises(ConfigurationError, match="offers: calibration, touch"):
        open_space(told, TASK, LAB)
    with pytest.raises(ConfigurationError, match="none besides the task"):
        open_space(description(), CALIBRATION, LAB)
    with pytest.raises(ConfigurationError, match="no scene"):
        open_space(replace(told, scene=""), CALIBRATION, LAB)
    odd = {CALIBRATION: {"low": (0.0, 0.0)}}
    with pytest.raises(ConfigurationError, match="needs low, high"):
        open_space(replace(told, workspaces=odd), CALIBRATION, LAB)


def test_obstacles_stand_where_the_box_is_known_to_stand() -> None:
    """In every workspace, and in it alone: what a way keeps clear of is before the robot."""
    displacement = (0.02, -0.012, 8.0)
    scene = MujocoScene(ArmSimulation(box=displacement))
    assert scene.known_box is not None
    told = description(
        scene=scene.shapes_json,
        workspaces=workspaces_told(scene, spaces_of(scene)),
        box_pose=scene.known_box.as_mapping(),
    )
    before_robot = np.linalg.inv(base_in_box(displacement))
    # A corner of the far wall's top, and one of the handle's, in the box's frame.
    corners = np.array([(0.100, 0.003, 0.083, 1.0), (0.024, -0.1435, 0.120, 1.0)]) @ before_robot.T
    ways = way_spaces(told, LAB, START)
    for checks in (open_space(told, CALIBRATION, LAB), *ways.values()):
        assert checks.obstacles
        for corner in corners[:, :3]:
            depth = max(_depth(corner, obstacle) for obstacle in checks.obstacles)
            assert depth == pytest.approx(0.0, abs=1e-9), "a corner of a box, or inside of none"


def _depth(point: Array, obstacle: Obstacle) -> float:
    """How far a point is inside of an obstacle, m; negative outside."""
    c, s = np.cos(obstacle.yaw), np.sin(obstacle.yaw)
    x, y, z = point - np.array(obstacle.centre)
    along = np.abs((c * x + s * y, c * y - s * x, z))
    return float((np.array(obstacle.half_size) - along).min())
