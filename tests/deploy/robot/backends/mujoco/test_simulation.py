"""The simulated robot with a variation: the one its seed draws, late servos, sensor errors."""

from __future__ import annotations

import numpy as np
import pytest

from skewmi.deploy.options import DeployOptions
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.sim.arm.batch import ArmBatch
from skewmi.sim.tasks.open_press_close.definition import ARM
from skewmi.trajectory import JointPoint


def move(robot: ArmSimulation, ticks: int, seed: int = 0) -> np.ndarray:
    """Measured arm positions while axis 4 follows a smooth start. Shape (ticks, 7)."""
    q0 = robot.reset(seed)
    measured = []
    for tick in range(ticks):
        t = 0.004 * (tick + 1)
        q, v = q0.copy(), np.zeros(7)
        q[4], v[4] = q0[4] + t**2, 2 * t
        robot.command = JointPoint(q, v, np.zeros(7))
        robot.step()
        measured.append(robot.robot_state(0).position[:7])
    return np.array(measured)


def test_values_that_equal_the_nominal_ones_change_no_bit() -> None:
    variation = "{servo: {kp_scale: 1, delay_ms: 0}, box_pose: {x: 0}, sensors: {joint_noise: 0}}"
    np.testing.assert_array_equal(
        move(ArmSimulation(variation=variation), 50), move(ArmSimulation(), 50)
    )


def test_the_seed_of_the_scene_decides_everything() -> None:
    robot = ArmSimulation(variation="randomised")
    first = move(robot, 30, seed=3)
    assert not np.array_equal(move(robot, 30, seed=4), first)
    np.testing.assert_array_equal(move(robot, 30, seed=3), first)
    np.testing.assert_array_equal(move(ArmSimulation(variation="randomised"), 30, seed=3), first)


def test_it_is_the_variation_that_one_environment_of_that_seed_has() -> None:
    robot = ArmSimulation(variation="randomised")
    robot.reset(0)
    robot.reset(5)
    env = ArmBatch(ARM, 1, num_threads=1, variation="randomised")
    env.reset(5)
    expected, model = env.batch.get_model(0), robot.scene.model
    for field in ("actuator_gainprm", "actuator_biasprm", "dof_frictionloss", "dof_armature",
                  "body_pos", "body_quat"):  # fmt: skip
        np.testing.assert_array_equal(getattr(model, field), getattr(expected, field))
    np.testing.assert_allclose(model.dof_invweight0, expected.dof_invweight0, rtol=1e-12)


def test_a_delay_is_a_shift_by_whole_ticks() -> None:
    late, prompt = (
        move(ArmSimulation(variation=f"{{servo: {{delay_ms: {ms}}}}}"), 60) for ms in (20, 0)
    )
    # After a reset the arm rests on its servos, so being late is all that differs.
    np.testing.assert_allclose(late[5:], prompt[:-5], atol=1e-6)
    assert prompt[-1, 4] - late[-1, 4] > 1e-3


def test_sensor_errors_are_drawn_once_a_tick() -> None:
    robot = ArmSimulation(
        variation="{sensors: {joint_noise: 0.001, lid_bias_deg: 2, button_noise: 0.001}}"
    )
    exact = ArmSimulation()
    errors = move(robot, 150) - move(exact, 150)
    assert errors.std(axis=0) == pytest.approx(0.001, rel=0.3)
    one, two = robot.robot_state(0), robot.robot_state(0)
    np.testing.assert_array_equal(one.position, two.position)
    lid, button = robot.scene_state().position
    assert np.degrees(lid) == pytest.approx(2.0, abs=0.1)
    assert button != exact.scene_state().position[1]


def test_the_gripper_is_off_by_its_error_before_and_after_a_command() -> None:
    robot, exact = ArmSimulation(variation="{gripper: {opening_error: 0.002}}"), ArmSimulation()
    for opening in (None, 0.018):
        gaps = []
        for each in (robot, exact):
            each.reset(0)
            if opening is not None:
                each.open_gripper(opening)
            for _ in range(150):
                each.step()
            gaps.append(each.robot_state(0).position[7])
        assert gaps[0] - gaps[1] == pytest.approx(0.002, abs=1e-4)


def test_a_running_robot_has_its_own_variation() -> None:
    with pytest.raises(ConfigurationError, match="give --variation to the skewmi robot"):
        DeployOptions(connect="tcp/127.0.0.1:7447", variation="randomised")


def test_unknown_task_is_named_with_those_that_exist() -> None:
    with pytest.raises(NotFoundError, match="open_press_close"):
        ArmSimulation("point_maze")
