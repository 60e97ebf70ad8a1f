"""MJCF and URDF: the same robot, the table's robot, and one that can be simulated."""

from __future__ import annotations

import mink
import mujoco
import numpy as np
import pinocchio
import pytest

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.robot_models import frames, mjcf, urdf, yumi
from skewmi.robot_models.kinematics import ArmKinematics


@pytest.fixture(scope="module")
def both_arms():
    """MuJoCo model and Pinocchio model of the whole robot, and joint names."""
    model = mjcf.build_robot(left_arm="jointed").compile()
    other = pinocchio.buildModelFromXML(urdf.build_urdf())
    names = [
        name for side in yumi.ARMS for name in (*yumi.joint_names(side), *yumi.finger_names(side))
    ]
    return model, other, names


def addresses(model, other, names):
    ours = np.array([model.joint(name).dofadr[0] for name in names])
    theirs = np.array([other.joints[other.getJointId(name)].idx_v for name in names])
    return ours, theirs


def draws(n, seed, fingers=True):
    generator = np.random.default_rng(seed)
    lower = np.concatenate([yumi.POSITION_LOWER, np.zeros(2)])
    upper = np.concatenate([yumi.POSITION_UPPER, np.full(2, yumi.GRIPPER.travel)])
    arm = generator.uniform(lower, upper, (n, 2, 9))
    return arm.reshape(n, 18)


def test_poses_jacobians_and_mass_matrices_agree(both_arms):
    model, other, names = both_arms
    ours, theirs = addresses(model, other, names)
    data, data_other = mujoco.MjData(model), other.createData()
    dense = np.zeros((model.nv, model.nv))
    for values in draws(25, seed=5):
        data.qpos[ours] = values
        q = np.zeros(other.nq)
        q[theirs] = values
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, dense)
        mass = pinocchio.crba(other, data_other, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        assert np.abs(dense[np.ix_(ours, ours)] - mass[np.ix_(theirs, theirs)]).max() < 1e-9
        gravity = pinocchio.computeGeneralizedGravity(other, data_other, q)
        assert np.abs(data.qfrc_bias[ours] - gravity[theirs]).max() < 1e-9
        pinocchio.framesForwardKinematics(other, data_other, q)
        for i, side in enumerate(yumi.ARMS):
            arm = ArmKinematics(side)
            tool = yumi.tool_name(side)
            position, rotation = arm.forward(values[9 * i : 9 * i + 7])
            site = data.site(tool)
            frame = other.getFrameId(tool)
            pose = data_other.oMf[frame]
            assert np.abs(site.xpos - position).max() < 1e-9
            assert np.abs(site.xmat.reshape(3, 3) - rotation).max() < 1e-9
            assert np.abs(pose.translation - position).max() < 1e-9
            assert np.abs(pose.rotation - rotation).max() < 1e-9
            linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
            mujoco.mj_jacSite(model, data, linear, angular, site.id)
            columns = slice(9 * i, 9 * i + 7)
            jacobian = arm.jacobian(values[columns])
            assert np.abs(np.vstack([linear, angular])[:, ours[columns]] - jacobian).max() < 1e-9
            theirs_jacobian = pinocchio.computeFrameJacobian(
                other, data_other, q, frame, pinocchio.LOCAL_WORLD_ALIGNED
            )
            assert np.abs(theirs_jacobian[:, theirs[columns]] - jacobian).max() < 1e-9


def test_limits_of_both_models_are_the_tables(both_arms):
    model, other, _ = both_arms
    for side in yumi.ARMS:
        for i, name in enumerate(yumi.joint_names(side)):
            joint = model.joint(name)
            assert joint.limited[0] == 1
            np.testing.assert_array_equal(
                joint.range, (yumi.POSITION_LOWER[i], yumi.POSITION_UPPER[i])
            )
            index = other.joints[other.getJointId(name)].idx_v
            assert other.lowerPositionLimit[index] == yumi.POSITION_LOWER[i]
            assert other.upperPositionLimit[index] == yumi.POSITION_UPPER[i]
            assert other.velocityLimit[index] == yumi.VELOCITY[i]
            assert other.effortLimit[index] == yumi.TORQUE[i]
        for name in yumi.finger_names(side):
            np.testing.assert_array_equal(model.joint(name).range, (0.0, yumi.GRIPPER.travel))
            index = other.joints[other.getJointId(name)].idx_v
            assert other.upperPositionLimit[index] == yumi.GRIPPER.travel
            assert other.velocityLimit[index] == yumi.GRIPPER.speed


def test_masses_are_the_tables(both_arms):
    model, _, _ = both_arms
    arm_mass = sum(inertial.mass for inertial in yumi.LINK_INERTIALS)
    # ABB: the robot weighs 38 kg, of which the body 24.18 kg.
    assert yumi.BODY_INERTIAL.mass + 2 * arm_mass == pytest.approx(38.0, abs=0.01)
    for i, name in enumerate(yumi.link_names("right")):
        body, inertial = model.body(name), yumi.LINK_INERTIALS[i]
        assert body.mass[0] == inertial.mass
        np.testing.assert_allclose(body.ipos, inertial.centre)
        assert body.inertia.sum() == pytest.approx(sum(inertial.inertia[:3]), rel=1e-6)
    hand = [model.body(f"gripper_l_{part}").mass[0] for part in ("base", "finger_r", "finger_l")]
    assert sum(hand) == pytest.approx(0.230, abs=1e-12)


def test_joints_come_in_chain_order_with_the_agreed_names():
    model = mjcf.build_robot().compile()
    names = [model.joint(i).name for i in range(model.njnt)]
    assert names == [
        "yumi_joint_1_r", "yumi_joint_2_r", "yumi_joint_7_r", "yumi_joint_3_r",
        "yumi_joint_4_r", "yumi_joint_5_r", "yumi_joint_6_r", "gripper_r_joint",
        "gripper_r_joint_m",
    ]  # fmt: skip
    parked = mujoco.MjData(model)
    mujoco.mj_forward(model, parked)
    position, _ = ArmKinematics("left").forward(yumi.HOME["left"])
    np.testing.assert_allclose(parked.site("tool0_l").xpos, position, atol=1e-12)


def test_options_change_what_they_say():
    absent = mjcf.build_robot(left_arm="absent").compile()
    assert absent.nbody == mjcf.build_robot().compile().nbody - 10
    bare = mjcf.build_robot(collision=False).compile()
    assert not bare.geom_contype.any()
    assert bare.nexclude == 0
    fast = mjcf.build_robot(visual=False).compile()
    assert fast.geom_contype.all()
    moved = mjcf.build_robot(base_position=tuple(frames.BASE_IN_WORLD)).compile()
    data = mujoco.MjData(moved)
    data.qpos[:7] = yumi.TABLE_CONFIGURATION
    mujoco.mj_forward(moved, data)
    np.testing.assert_allclose(data.site("tool0_r").xpos, (-0.009, -0.1345, 0.270), atol=1e-9)
    with pytest.raises(ConfigurationError, match="hooked, straight"):
        mjcf.build_robot(fingers="long")  # type: ignore[arg-type]
    with pytest.raises(ConfigurationError, match="parked, jointed, absent"):
        mjcf.build_robot(left_arm="gone")  # type: ignore[arg-type]
    with pytest.raises(ConfigurationError, match="at most once"):
        urdf.build_urdf(arms=())
    with pytest.raises(NotFoundError, match="right, left"):
        urdf.build_urdf(arms=("third",))  # type: ignore[arg-type]


def test_urdf_loads_in_mujoco_and_collides_in_pinocchio():
    text = urdf.build_urdf(arms=("right",))
    again = mujoco.MjModel.from_xml_string(text)
    assert [again.joint(i).name for i in range(7)] == list(yumi.joint_names("right"))
    model = pinocchio.buildModelFromXML(text, True)
    # Read with mimic joints, the hand has one degree of freedom.
    assert model.nv == 8
    plain = pinocchio.buildModelFromXML(text)
    geometry = pinocchio.buildGeomFromUrdfString(plain, text, pinocchio.GeometryType.COLLISION)
    reference = mjcf.build_robot(left_arm="absent", visual=False).compile()
    assert geometry.ngeoms == reference.ngeom
    # Every collision shape is at the same place in both models.
    data, geometry_data = plain.createData(), geometry.createData()
    q = np.concatenate([yumi.TABLE_CONFIGURATION, [0.014, 0.014]])
    pinocchio.updateGeometryPlacements(plain, data, geometry, geometry_data, q)
    theirs = np.array([pose.translation for pose in geometry_data.oMg])
    ours = mujoco.MjData(reference)
    ours.qpos[:] = q
    mujoco.mj_forward(reference, ours)
    for centre in ours.geom_xpos:
        assert np.linalg.norm(theirs - centre, axis=1).min() < 1e-9


def test_mink_solves_on_the_model():
    """The robot alone is a model mink can use, and mink and we mean the same hand frame."""
    model = mjcf.build_robot(left_arm="absent", visual=False).compile()
    configuration = mink.Configuration(model)
    q = np.zeros(model.nq)
    q[:7] = yumi.TABLE_CONFIGURATION
    configuration.update(q)
    target = frames.world_to_base((-0.015, 0.120, 0.200))
    task = mink.FrameTask("tool0_r", "site", position_cost=1.0, orientation_cost=1.0)
    rotation = mink.SO3.from_matrix(frames.HAND_DOWN)
    task.set_target(mink.SE3.from_rotation_and_translation(rotation, target))
    limits = [mink.ConfigurationLimit(model)]
    for _ in range(100):
        velocity = mink.solve_ik(configuration, [task], 0.02, "daqp", limits=limits)
        configuration.integrate_inplace(velocity, 0.02)
    position, found = ArmKinematics("right").forward(configuration.q[:7])
    np.testing.assert_allclose(position, target, atol=1e-8)
    np.testing.assert_allclose(found, frames.HAND_DOWN, atol=1e-8)


def test_visual_geoms_take_no_part_in_physics():
    model = mjcf.build_robot().compile()
    visual = model.geom_group == mjcf.VISUAL_GROUP
    assert visual.any()
    assert not model.geom_contype[visual].any()
    assert not model.geom_conaffinity[visual].any()
    assert set(model.geom_group) == {mjcf.VISUAL_GROUP, mjcf.COLLISION_GROUP}


def test_fingers_point_and_open_as_the_paper_has_them():
    """Hand down: fingers open along world y, the +y one has a hook towards the other."""
    model = mjcf.build_robot().compile()
    data = mujoco.MjData(model)
    data.qpos[:7] = yumi.TABLE_CONFIGURATION
    data.qpos[7:9] = 0.014
    mujoco.mj_forward(model, data)
    flange = data.site("tool0_r").xpos
    boxes = {}
    for i in range(model.ngeom):
        body = model.body(model.geom_bodyid[i]).name
        if body.startswith("gripper_r_finger") and model.geom_group[i] == mjcf.COLLISION_GROUP:
            half = np.abs(data.geom_xmat[i].reshape(3, 3)) @ model.geom_size[i]
            centre = data.geom_xpos[i] - flange
            boxes.setdefault(body, []).append((centre - half, centre + half))
    plain = boxes["gripper_r_finger_r"]
    hooked = boxes["gripper_r_finger_l"]
    assert len(plain) == 1
    assert len(hooked) == 2
    np.testing.assert_allclose(
        plain[0], [(-0.007, -0.024, -0.1357), (0.007, -0.014, -0.0837)], atol=1e-9
    )
    low, high = (
        np.min([box[0] for box in hooked], axis=0),
        np.max([box[1] for box in hooked], axis=0),
    )
    np.testing.assert_allclose(low, (-0.007, 0.004, -0.1357), atol=1e-9)
    np.testing.assert_allclose(high, (0.007, 0.024, -0.0837), atol=1e-9)
