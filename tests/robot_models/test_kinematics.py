"""Kinematics: nominal ABB model, two statements of it, three implementations, laws."""

from __future__ import annotations

import numpy as np
import pytest
from costs import cost_ratio
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.errors import KinematicsError, NotFoundError
from skewmi.robot_models import frames, kinematics, yumi
from skewmi.robot_models.kinematics import ArmKinematics

# Right and left arm at the same joint angles (deg): position, quaternion wxyz. The home rows are
# values of ABB's RobotStudio, the others were computed by a separate program.
VECTORS = [
    ("left", (0, 0, 0, 0, 0, 0, 0), (0.567822, -0.004731, 0.415132),
     (0.297604, -0.067327, 0.874615, -0.376760)),
    ("right", (0, 0, 0, 0, 0, 0, 0), (0.567822, 0.004731, 0.415132),
     (0.297604, 0.067327, 0.874615, 0.376760)),
    ("left", (0, -130, 135, 30, 0, 40, 0), (-0.009578, 0.182610, 0.198628),
     (0.066011, 0.842421, -0.111215, 0.523069)),
    ("right", (0, -130, -135, 30, 0, 40, 0), (-0.009578, -0.182610, 0.198628),
     (0.066011, -0.842421, -0.111215, -0.523069)),
    ("left", (20, -60, 40, -30, 50, 60, -70), (0.295576, 0.531930, 0.754322),
     (0.371578, -0.789952, 0.451982, 0.183352)),
    ("right", (20, -60, 40, -30, 50, 60, -70), (0.271444, -0.371688, 0.912768),
     (0.795462, -0.346879, 0.107270, 0.485189)),
    ("left", (-75, -90, 100, 10, -120, 30, 45), (0.315998, 0.190763, 0.059633),
     (0.150128, 0.891836, 0.051691, 0.423578)),
    ("right", (-75, -90, 100, 10, -120, 30, 45), (0.239344, 0.318223, 0.562912),
     (0.562450, -0.730014, 0.164618, -0.351610)),
]  # fmt: skip

angles = st.lists(st.floats(-1.0, 1.0), min_size=7, max_size=7).map(
    lambda shares: (
        0.5 * (yumi.POSITION_LOWER + yumi.POSITION_UPPER)
        + 0.5 * (yumi.POSITION_UPPER - yumi.POSITION_LOWER) * np.array(shares)
    )
)


def random_configurations(n: int, seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    return generator.uniform(yumi.POSITION_LOWER, yumi.POSITION_UPPER, (n, 7))


@pytest.mark.parametrize(("side", "degrees", "position", "quaternion"), VECTORS)
def test_forward_meets_the_published_poses(side, degrees, position, quaternion):
    found_position, rotation = ArmKinematics(side).forward(np.radians(degrees))
    assert np.abs(found_position - position).max() < 1e-5
    found = frames.quaternion_from_rotation(rotation)
    # Published with six digits; q and -q are the same orientation.
    assert np.abs(found * np.sign(found @ quaternion) - quaternion).max() < 1e-6


@pytest.mark.parametrize("side", yumi.ARMS)
def test_link_frames_and_dh_rows_state_the_same_arm(side):
    arm = ArmKinematics(side)
    a, b, c = yumi.ARM_BASE_XYZ_ANGLES[side]
    base = frames.rotation_about(0, a) @ frames.rotation_about(1, b) @ frames.rotation_about(2, c)
    for q in random_configurations(50, seed=1):
        position, rotation = np.array(yumi.ARM_BASE_POSITION[side]), base
        angle = [*q, 0.0]
        for i, origin in enumerate((*yumi.LINK_ORIGINS, yumi.FLANGE_ORIGIN)):
            position = position + rotation @ np.array(origin.position)
            rotation = rotation @ frames.rotation_from_rpy(origin.rpy)
            rotation = rotation @ frames.rotation_about(2, angle[i])
        found_position, found_rotation = arm.forward(q)
        assert np.abs(found_position - position).max() < 1e-12
        assert np.abs(found_rotation - rotation).max() < 1e-12


@given(q=angles)
@settings(max_examples=50, deadline=None)
def test_the_arms_mirror_each_other(q):
    position, rotation = ArmKinematics("right").forward(q)
    mirrored, other = ArmKinematics("left").forward(q * yumi.MIRROR_SIGNS)
    flip = np.diag([1.0, -1.0, 1.0])
    assert np.abs(mirrored - flip @ position).max() < 1e-12
    # Mirroring a frame makes it left-handed; turning y over as well makes it a frame again.
    assert np.abs(other - flip @ rotation @ flip).max() < 1e-12


@given(q=angles)
@settings(max_examples=50, deadline=None)
def test_jacobian_is_the_derivative_of_forward(q):
    arm, h = ArmKinematics("right"), 1e-6
    jacobian = arm.jacobian(q)
    forth = arm.forward(q + h * np.eye(7))
    back = arm.forward(q - h * np.eye(7))
    linear = (forth[0] - back[0]).T / (2 * h)
    turn = frames.rotation_vector(forth[1] @ back[1].swapaxes(-1, -2)).T / (2 * h)
    assert np.abs(jacobian[:3] - linear).max() < 1e-8
    assert np.abs(jacobian[3:] - turn).max() < 1e-8


def test_batches_keep_their_shape_and_agree_with_single_calls():
    arm = ArmKinematics("right")
    q = random_configurations(6, seed=2).reshape(2, 3, 7)
    position, rotation = arm.forward(q)
    jacobian = arm.jacobian(q)
    assert position.shape == (2, 3, 3)
    assert rotation.shape == (2, 3, 3, 3)
    assert jacobian.shape == (2, 3, 6, 7)
    single_position, single_rotation = arm.forward(q[1, 2])
    np.testing.assert_allclose(position[1, 2], single_position, atol=1e-15)
    np.testing.assert_allclose(rotation[1, 2], single_rotation, atol=1e-15)
    np.testing.assert_allclose(jacobian[1, 2], arm.jacobian(q[1, 2]), atol=1e-15)


@pytest.mark.parametrize("side", yumi.ARMS)
def test_inverse_returns_to_the_pose_it_was_given(side):
    arm = ArmKinematics(side)
    generator = np.random.default_rng(3)
    q = generator.uniform(arm.position_lower + 0.3, arm.position_upper - 0.3, (200, 7))
    start = q + generator.uniform(-0.1, 0.1, q.shape)
    position, rotation = arm.forward(q)
    result = arm.inverse(position, rotation, start, max_iterations=40)
    assert result.position_error.max() < 1e-6
    assert result.rotation_error.max() < 1e-6
    found_position, found_rotation = arm.forward(result.q)
    # The reported errors are those of the returned configuration.
    np.testing.assert_allclose(
        np.linalg.norm(found_position - position, axis=-1), result.position_error, atol=1e-12
    )
    turn = frames.rotation_vector(rotation @ found_rotation.swapaxes(-1, -2))
    np.testing.assert_allclose(np.linalg.norm(turn, axis=-1), result.rotation_error, atol=1e-9)
    kinematics.require_converged(result)


def test_inverse_never_leaves_the_limits():
    arm = ArmKinematics("right")
    q = random_configurations(100, seed=4)
    position, rotation = arm.forward(q)
    result = arm.inverse(position + 0.2, rotation, q, max_iterations=20)
    assert np.all(result.q >= arm.position_lower)
    assert np.all(result.q <= arm.position_upper)
    assert np.all(arm.position_lower > yumi.POSITION_LOWER)
    assert np.all(arm.position_upper < yumi.POSITION_UPPER)


def test_posture_is_approached_without_moving_the_hand():
    arm = ArmKinematics("right")
    posture = np.array(yumi.TABLE_CONFIGURATION)
    position, rotation = arm.forward(posture)
    along_the_swivel = np.linalg.svd(arm.jacobian(posture))[2][-1]
    away = arm.inverse(position, rotation, posture + 0.4 * along_the_swivel, max_iterations=40).q
    result = arm.inverse(
        position,
        rotation,
        away,
        posture=posture,
        posture_gain=0.5,
        posture_iterations=40,
        max_iterations=45,
    )
    assert np.abs(away - posture).max() > 0.05
    assert np.abs(result.q - posture).max() < 1e-3
    assert result.position_error < 1e-6


def test_a_batch_does_not_influence_its_members():
    arm = ArmKinematics("right")
    q = np.array(yumi.TABLE_CONFIGURATION)
    position, rotation = arm.forward(q)
    targets = position + np.array([[0.0, 0.0, 0.0], [0.005, 0.01, -0.01], [0.3, 0.5, 0.4]])
    together = arm.inverse(targets, rotation, q, posture=q)
    for i, target in enumerate(targets):
        alone = arm.inverse(target, rotation, q, posture=q)
        np.testing.assert_allclose(together.q[i], alone.q, atol=1e-12)


def test_nearly_half_a_turn_away_converges():
    arm = ArmKinematics("right")
    q = np.array(yumi.TABLE_CONFIGURATION)
    position, rotation = arm.forward(q)
    # The last axis is the tool's z axis and can turn back that far.
    turned = rotation @ frames.rotation_about(2, -0.999 * np.pi)
    result = arm.inverse(position, turned, q, max_iterations=100)
    assert result.rotation_error < 1e-6
    assert result.position_error < 1e-6


def test_an_unreachable_pose_is_reported():
    arm = ArmKinematics("right")
    result = arm.inverse((2.0, 0.0, 0.3), frames.HAND_DOWN, yumi.TABLE_CONFIGURATION)
    with pytest.raises(KinematicsError, match="cannot be reached"):
        kinematics.require_converged(result)


def test_bad_input_is_refused_in_words():
    with pytest.raises(NotFoundError, match="right, left"):
        ArmKinematics("middle")  # type: ignore[arg-type]
    with pytest.raises(KinematicsError, match="7 joints"):
        ArmKinematics().forward(np.zeros(6))


@given(
    rotation_vector=st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).map(np.array),
    angle=st.floats(0.0, np.pi),
)
@settings(max_examples=100, deadline=None)
def test_orientations_convert_there_and_back(rotation_vector, angle):
    length = np.linalg.norm(rotation_vector)
    axis = rotation_vector / length if length > 1e-3 else np.array([0.0, 0.0, 1.0])
    quaternion = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])
    rotation = frames.rotation_from_quaternion(quaternion)
    assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-12
    back = frames.quaternion_from_rotation(rotation)
    assert abs(abs(back @ quaternion) - 1.0) < 1e-12
    rpy = frames.rpy_from_rotation(rotation)
    assert np.abs(frames.rotation_from_rpy(rpy) - rotation).max() < 1e-7
    again = frames.rotation_vector(rotation)
    assert abs(np.linalg.norm(again) - angle) < 1e-7


def test_the_tasks_hold_the_hand_straight_down():
    np.testing.assert_allclose(
        frames.rotation_from_quaternion(frames.HAND_DOWN_QUATERNION_WXYZ),
        frames.HAND_DOWN,
        atol=1e-15,
    )
    np.testing.assert_array_equal(frames.HAND_DOWN @ (0, 0, 1), (0, 0, -1))
    np.testing.assert_array_equal(frames.HAND_DOWN @ (1, 0, 0), (0, 1, 0))
    np.testing.assert_allclose(frames.base_to_world(frames.world_to_base((1, 2, 3))), (1, 2, 3))


def test_a_warm_start_is_cheap_enough_to_run_at_every_step():
    """Some twelve forward kinematics of the same arms; 0.5 ms of a quick computer."""
    arm = ArmKinematics("right")
    q = np.tile(yumi.TABLE_CONFIGURATION, (25, 1))
    position, rotation = arm.forward(q)

    def inverse():
        return arm.inverse(position + 0.01, rotation, q, posture=q, max_iterations=4)

    assert inverse().position_error.max() < 1e-6
    assert cost_ratio(inverse, lambda: arm.forward(q), 60) < 40.0


def test_unchecked_iterations_are_the_same_iterations() -> None:
    generator = np.random.default_rng(3)
    arm = ArmKinematics("right")
    start = generator.uniform(-0.5, 0.5, (5, 7))
    position, rotation = arm.forward(start + generator.uniform(-0.02, 0.02, (5, 7)))
    two = arm.inverse(position, rotation, start, max_iterations=2)
    unchecked = arm.inverse(position, rotation, start, unchecked_iterations=2)
    np.testing.assert_array_equal(unchecked.q, two.q)
    # The errors are those before the last iteration, which improves on them.
    assert (unchecked.position_error > two.position_error).all()
