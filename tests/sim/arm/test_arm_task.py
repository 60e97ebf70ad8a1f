"""Tasks of the arm that are none of ours: whatever stands on the table, the laws are the same."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from skewmi.errors import ConfigurationError
from skewmi.policy_io import TIME_FIELD, Ball, Field
from skewmi.robot_models import servo, yumi
from skewmi.sim.arm.arm_task import ArmTask, SensedJoint
from skewmi.sim.arm.batch import ArmBatch
from skewmi.sim.arm.scene import ArmScene
from skewmi.sim.arm.table import add_box
from skewmi.sim.arm.variation_keys import ARM_KEYS, joint_key
from skewmi.sim.variation import VariationKey, Variations

DOOR = SensedJoint(
    "door_hinge", Field("door_angle", "rad", "hinge", 0.0, 1.5), start=0.3, noise_key="sensors.door"
)
DRAWER = SensedJoint("drawer_slide", Field("drawer_way", "m", "slide", 0.0, 0.2))


def add_door_and_drawer(spec: mujoco.MjSpec) -> None:
    for joint, kind, y in (
        (DRAWER, mujoco.mjtJoint.mjJNT_SLIDE, 0.30),
        (DOOR, mujoco.mjtJoint.mjJNT_HINGE, -0.30),
    ):
        body = spec.worldbody.add_body(name=joint.name.partition("_")[0], pos=(0.2, y, 0.1))
        body.add_joint(name=joint.name, type=kind, axis=(0.0, 0.0, 1.0), frictionloss=1.0)
        add_box(body, f"{body.name}_box", ((0.19, y, 0.1), (0.21, y + 0.02, 0.12)), (1, 0, 0, 1),
                origin=body.pos, mass=0.1)  # fmt: skip


TASK = ArmTask(
    name="tidy_up",
    low=(-0.019, -0.155, 0.190),
    high=(0.001, 0.135, 0.355),
    start=(-0.009, -0.1345, 0.270),
    start_configuration=yumi.TABLE_CONFIGURATION,
    joints=(DOOR, DRAWER),
    add_parts=add_door_and_drawer,
    success=(Ball(("door_angle",), (0.3,), 0.1),),
    success_hold_steps=2,
    episode_steps=7,
    variations=Variations(
        (
            *ARM_KEYS,
            joint_key("drawer.frictionloss", "dof_frictionloss", DRAWER.name, 0.0, 9.0, "N"),
            VariationKey("sensors.door", 0.0, 0.1, "rad"),
        )
    ),
)


def test_the_layout_has_hand_gripper_joints_and_time_in_this_order() -> None:
    layout = TASK.layout(gripper_action=True, time_input=True)
    hand = ("hand_x", "hand_y", "hand_z", "gripper")
    assert layout.observation_names == (*hand, "door_angle", "drawer_way", TIME_FIELD)
    assert [field.name for field in layout.action] == list(hand)
    assert (layout.episode_steps, layout.success_hold_steps) == (7, 2)
    assert layout.reward_region[3:] == TASK.success
    assert {ball.fields for ball in layout.reward_region[:3]} == {(name,) for name in hand[:3]}


def test_joints_are_read_in_the_order_of_the_task_not_of_the_model() -> None:
    scene = ArmScene(TASK)
    data = mujoco.MjData(scene.model)
    scene.reset(data)
    data.joint("door_hinge").qpos, data.joint("drawer_slide").qpos = 0.7, 0.05
    np.testing.assert_array_equal(data.qpos[scene.scene_qpos], [0.7, 0.05])
    read = scene.read(data)
    assert (read["door_angle"], read["drawer_way"]) == (0.7, 0.05)
    assert TASK.scene_fields == {"door_hinge": "door_angle", "drawer_slide": "drawer_way"}


def test_an_episode_starts_where_the_joints_say_and_succeeds_in_the_region() -> None:
    env = ArmBatch(TASK, 2, num_threads=1)
    np.testing.assert_array_equal(env.reset(0)[:, 4:], [[0.3, 0.0]] * 2)
    result = env.step(np.zeros((2, 3)))
    assert result.success.all()
    assert result.reward.tolist() == [1.0, 1.0]
    env.batch.bind("qpos")[:, env.scene.scene_qpos[0]] = 0.9
    assert not env.step(np.zeros((2, 3))).success.any()


def test_a_scene_may_have_no_joints_at_all() -> None:
    reach = replace(
        TASK,
        joints=(),
        add_parts=lambda spec: None,
        success=(Ball(("hand_y",), (0.0,), 0.02),),
        variations=Variations(ARM_KEYS),
    )
    for variation in (None, '{"sensors": {"joint_noise": 0.001}, "servo": {"delay_ms": 8}}'):
        env = ArmBatch(reach, 2, num_threads=1, variation=variation)
        assert env.reset(0).shape == (2, 4)
        assert not env.step(np.ones((2, 3))).success.any()
        assert env.reachable(env.reset()).all()


def test_reachable_is_the_ranges_with_their_give_and_what_the_task_tells() -> None:
    state = np.array([-0.009, 0.0, 0.3, 0.01, 0.0, 0.1])
    strict = replace(TASK, possible=lambda value: value["drawer_way"] < 0.05)
    env, other = (ArmBatch(task, 1, num_threads=1) for task in (TASK, strict))
    assert env.reachable(state)
    assert not other.reachable(state)
    beyond = state + np.array([0, 0, 0, 0, 1.5 + 1.1 * DOOR.give, 0])
    assert not env.reachable(beyond)
    assert env.reachable(beyond - np.array([0, 0, 0, 0, 0.2 * DOOR.give, 0]))


def test_a_key_of_the_task_and_its_sensors_noise_do_what_they_say() -> None:
    variation = '{"drawer": {"frictionloss": 4}, "sensors": {"door": 0.05}}'
    env = ArmBatch(TASK, 200, num_threads=1, variation=variation)
    observation = env.reset(0)
    dof = env.scene.scene_dof[1]
    np.testing.assert_array_equal(env.batch.expanded("dof_frictionloss")[:, dof], 4.0)
    assert observation[:, 4].std() == pytest.approx(0.05, rel=0.2)
    np.testing.assert_array_equal(observation[:, 5], 0.0)


def test_servos_are_the_tasks() -> None:
    scene = ArmScene(replace(TASK, servo=servo.DEFAULT))
    np.testing.assert_array_equal(scene.model.actuator_gainprm[scene.arm_ctrl, 0], servo.DEFAULT.kp)


def test_keys_that_the_variations_lack_are_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"door_hinge.*sensors\.door"):
        replace(TASK, variations=Variations(ARM_KEYS))
