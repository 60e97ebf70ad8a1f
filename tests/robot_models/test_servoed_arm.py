"""Servos of the MuJoCo model: what they are told to be, and how an arm moves with them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from skewmi.errors import ConfigurationError
from skewmi.robot_models import mjcf, servo, yumi


@pytest.fixture(scope="module")
def servoed():
    spec = mjcf.build_robot()
    mjcf.add_position_servos(spec, servo.DEFAULT)
    spec.option.timestep = 0.004
    return spec.compile()


def test_servos_are_the_parameters(servoed):
    names = [servoed.actuator(i).name for i in range(servoed.nu)]
    assert names == [*yumi.joint_names("right"), "gripper_r_joint"]
    for i in range(7):
        actuator = servoed.actuator(i)
        assert actuator.gainprm[0] == servo.DEFAULT.kp[i]
        assert -actuator.biasprm[2] == servo.DEFAULT.kd[i]
        np.testing.assert_array_equal(
            actuator.forcerange, (-servo.DEFAULT.force_limit[i], servo.DEFAULT.force_limit[i])
        )
        dof = servoed.joint(names[i]).dofadr[0]
        assert servoed.dof_armature[dof] == servo.DEFAULT.armature[i]
        assert servoed.dof_frictionloss[dof] == servo.DEFAULT.frictionloss[i]


def test_the_servoed_arm_holds_still_against_gravity(servoed):
    data = mujoco.MjData(servoed)
    data.qpos[:7] = data.ctrl[:7] = yumi.TABLE_CONFIGURATION
    data.qpos[7:9] = data.ctrl[7] = 0.014
    for _ in range(250):
        mujoco.mj_step(servoed, data)
    assert np.abs(data.qpos[:7] - yumi.TABLE_CONFIGURATION).max() < 1e-6
    assert data.ncon == 0


def test_a_step_is_followed_without_overshoot(servoed):
    """Critical damping: the hand joints come within friction's reach and never far beyond."""
    data = mujoco.MjData(servoed)
    goal = np.array(yumi.TABLE_CONFIGURATION)
    data.qpos[:7] = goal
    data.qpos[7:9] = data.ctrl[7] = 0.014
    goal = goal + 0.01
    data.ctrl[:7] = goal
    furthest = np.full(7, -np.inf)
    for _ in range(250):
        mujoco.mj_step(servoed, data)
        furthest = np.maximum(furthest, data.qpos[:7] - goal)
    dead_band = servo.DEFAULT.frictionloss / servo.DEFAULT.kp
    assert np.all(furthest < 1e-3)
    assert np.all(np.abs(data.qpos[:7] - goal) < dead_band + 5e-4)


def test_fingers_move_together_at_the_grippers_speed(servoed):
    data = mujoco.MjData(servoed)
    data.qpos[:7] = data.ctrl[:7] = yumi.TABLE_CONFIGURATION
    data.qpos[7:9] = 0.010
    data.ctrl[7] = 0.024
    fastest = apart = 0.0
    for _ in range(500):
        mujoco.mj_step(servoed, data)
        fastest = max(fastest, np.abs(data.qvel[7:9]).max())
        apart = max(apart, abs(data.qpos[7] - data.qpos[8]))
    assert np.abs(data.qpos[7:9] - 0.024).max() < 2e-4
    assert apart < 2e-4
    assert 0.8 * yumi.GRIPPER.speed < fastest < 1.05 * yumi.GRIPPER.speed


def test_servo_parameters_refuse_nonsense():
    with pytest.raises(ConfigurationError, match="kp must be 7"):
        servo.DEFAULT.with_changes(kp=np.ones(6))
    with pytest.raises(ConfigurationError, match="none negative"):
        servo.DEFAULT.with_changes(frictionloss=-np.ones(7))
    with pytest.raises(ConfigurationError, match="finger_kp"):
        servo.DEFAULT.with_changes(finger_kp=float("nan"))
