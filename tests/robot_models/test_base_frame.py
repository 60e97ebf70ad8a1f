"""The robot base in a task's frame: against MuJoCo with a robot that is really moved."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from moved_boxes import ORIGIN, base_in_box, box_moved, drawn, hand_by_mujoco

from skewmi.errors import ConfigurationError
from skewmi.robot_models import yumi
from skewmi.robot_models.base_frame import NOMINAL_BASE, BaseFrame, BoxPose, base_of
from skewmi.robot_models.frames import BASE_IN_WORLD
from skewmi.robot_models.kinematics import ArmKinematics

FINITE = st.floats(-2.0, 2.0)
FRAMES = st.builds(BaseFrame, st.tuples(FINITE, FINITE, FINITE), st.floats(-4.0, 4.0))
POINTS = st.tuples(FINITE, FINITE, FINITE)


def test_the_hand_is_where_a_robot_that_is_moved_has_it() -> None:
    rng = np.random.default_rng(5)
    arm = ArmKinematics("right")
    for _ in range(20):
        displacement = drawn(rng, 0.05, 20.0)
        base = BoxPose(*displacement, *ORIGIN).base_frame()
        q = rng.uniform(yumi.POSITION_LOWER, yumi.POSITION_UPPER, (5, 7))
        position, rotation = arm.forward(q)
        velocity = arm.jacobian(q)[:, :3] @ np.ones(7)
        for k, joints in enumerate(q):
            seen, turned = hand_by_mujoco(joints, displacement)
            np.testing.assert_allclose(base.to_task(position)[k], seen, atol=1e-9)
            np.testing.assert_allclose(base.rotations_to_task(rotation)[k], turned, atol=1e-9)
            ahead, _ = hand_by_mujoco(joints + 1e-6, displacement)
            behind, _ = hand_by_mujoco(joints - 1e-6, displacement)
            moved = base.vectors_to_task(velocity)[k]
            np.testing.assert_allclose(moved, (ahead - behind) / 2e-6, atol=1e-7)


def test_a_displaced_box_is_where_the_undisplaced_one_is_in_its_own_frame() -> None:
    rng = np.random.default_rng(6)
    for _ in range(50):
        displacement = drawn(rng, 0.05, 20.0)
        base = BoxPose(*displacement, *ORIGIN).base_frame()
        corner = np.append(rng.uniform(-0.3, 0.3, 3), 1.0)
        before_robot = NOMINAL_BASE.to_base((box_moved(displacement) @ corner)[:3])
        np.testing.assert_allclose(base.to_task(before_robot), corner[:3], atol=1e-12)
        np.testing.assert_allclose(base.rotation, base_in_box(displacement)[:3, :3], atol=1e-12)


@given(FRAMES, POINTS, POINTS)
@settings(deadline=None)
def test_there_and_back_is_nowhere(base: BaseFrame, first: object, second: object) -> None:
    p, r = np.array(first), np.array(second)
    np.testing.assert_allclose(base.to_base(base.to_task(p)), p, atol=1e-12)
    np.testing.assert_allclose(base.vectors_to_base(base.vectors_to_task(p)), p, atol=1e-12)
    apart = base.to_task(p) - base.to_task(r)
    np.testing.assert_allclose(base.vectors_to_task(p - r), apart, atol=1e-12)
    assert np.linalg.norm(apart) == pytest.approx(np.linalg.norm(p - r), abs=1e-12)
    assert base.to_task(p)[2] == pytest.approx(p[2] + base.position[2])
    turn = base.rotations_to_task(np.eye(3))
    np.testing.assert_allclose(base.rotations_to_base(turn), np.eye(3), atol=1e-12)


@given(st.tuples(FINITE, FINITE, FINITE), POINTS)
def test_without_a_turn_not_a_bit_differs_from_a_shift(position: object, point: object) -> None:
    base, p = BaseFrame(position), np.array(point)  # type: ignore[arg-type]
    np.testing.assert_array_equal(base.to_task(p), p + np.array(position))
    np.testing.assert_array_equal(base.to_base(p), p - np.array(position))
    np.testing.assert_array_equal(base.vectors_to_task(p), p)
    assert base.rotations_to_base(p) is p


def test_a_box_in_its_place_leaves_the_base_in_its_own() -> None:
    assert base_of(None) is NOMINAL_BASE
    assert BoxPose(0.0, 0.0, 0.0, *ORIGIN).base_frame() is NOMINAL_BASE
    np.testing.assert_array_equal(NOMINAL_BASE.position, BASE_IN_WORLD)


@pytest.mark.parametrize(
    "wrong",
    [
        (0.0501, 0, 0),
        (0, -0.0501, 0),
        (0, 0, 20.01),
        (0, 0, -20.01),
        (np.nan, 0, 0),
        (0, np.inf, 0),
    ],
)
def test_a_box_that_is_somewhere_else_altogether_is_refused(wrong: tuple[float, ...]) -> None:
    with pytest.raises(ConfigurationError, match="the calibration says that the box stands"):
        BoxPose(*wrong, *ORIGIN)
    with pytest.raises(ConfigurationError):
        BoxPose(0.0, 0.0, 0.0, float("nan"), 0.0)


def test_a_box_survives_a_document_and_nonsense_does_not() -> None:
    box = BoxPose(0.1 / 3, -0.01, 7.0 / 3, *ORIGIN)
    assert BoxPose.of_mapping(box.as_mapping()) == box
    assert BoxPose.of_mapping({}) is None
    for wrong in ({"x": 0.0}, box.as_mapping() | {"z": 0.0}, box.as_mapping() | {"x": "far"}):
        with pytest.raises(ConfigurationError, match="yaw_deg"):
            BoxPose.of_mapping(wrong)  # type: ignore[arg-type]


def test_a_base_that_is_nowhere_is_refused() -> None:
    for position, yaw in (((np.nan, 0, 0), 0), ((0, 0), 0), ((0, 0, 0), np.inf)):
        with pytest.raises(ConfigurationError, match="robot base"):
            BaseFrame(position, yaw)  # type: ignore[arg-type]
