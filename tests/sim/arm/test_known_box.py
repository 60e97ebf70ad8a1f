"""A box that stands elsewhere and is known to, in the batched simulation."""

from __future__ import annotations

import json

import mujoco
import numpy as np
import pytest
from moved_boxes import ORIGIN, Displacement, box_moved, calibration_at, drawn, hand_by_mujoco
from scripted_episodes import NUM_ENVS, ScriptedEpisodes
from scripted_open_press_close import ScriptedOpenPressClose
from unknown_robots import exact_calibration

from skewmi.calibration.calibration_file import Calibration
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array
from skewmi.robot_models import yumi
from skewmi.robot_models.frames import HAND_DOWN, rotation_vector
from skewmi.sim.arm.batch import ArmBatch
from skewmi.sim.arm.known import Known
from skewmi.sim.arm.scene import ArmScene, workspace_of
from skewmi.sim.tasks.door_open.definition import ARM as DOOR
from skewmi.sim.tasks.open_press_close.definition import ARM

MOVES = np.array([[0.0, 0.6, 0.8]] * 6 + [[0.5, -0.6, 0.3]] * 4 + [[-0.5, 0.0, -0.5]] * 4)
"""Actions that keep clear of the box."""


def varied(displacement: Displacement) -> str:
    return json.dumps({"box_pose": dict(zip(("x", "y", "yaw_deg"), displacement, strict=True))})


def batch(
    displacement: Displacement | None, calibration: Calibration | None = None, n: int = 2
) -> ArmBatch:
    variation = None if displacement is None else varied(displacement)
    return ArmBatch(ARM, n, num_threads=1, seed=3, variation=variation, calibration=calibration)


def hand_in_true_box(env: ArmBatch, index: int) -> Array:
    """Where MuJoCo has the hand, seen from where MuJoCo has the box, m. Shape (3,)."""
    scene = env.scene
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[:] = env.batch.bind("qpos")[index]
    mujoco.mj_kinematics(model, data)
    box = model.body("box").id
    position = np.array(env.batch.expand("body_pos"))[index, box]
    quaternion = np.array(env.batch.expand("body_quat"))[index, box]
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, quaternion)
    hand = data.site(yumi.tool_name("right")).xpos
    seen: Array = turn.reshape(3, 3).T @ (hand - position)
    return seen + np.array([*ORIGIN, 0.0])


def test_the_policy_sees_and_moves_the_hand_in_the_frame_of_the_true_box() -> None:
    rng = np.random.default_rng(1)
    for displacement in (drawn(rng), drawn(rng), (0.02, -0.012, 8.0)):
        env = batch(displacement, calibration_at(*displacement))
        observation = env.reset()
        start = np.array(workspace_of(ARM.layout()).start)
        assert np.abs(observation[:, :3] - start).max() <= 0.005 + 1e-6
        for action in MOVES:
            for k in range(env.num_envs):
                np.testing.assert_allclose(observation[k, :3], hand_in_true_box(env, k), atol=1e-9)
            before = env.command()[0]
            observation = env.step(np.tile(action, (env.num_envs, 1))).observation
            moved = env.command()[0] - before
            low, high = np.array(ARM.low), np.array(ARM.high)
            assert (env.command()[0] >= low - 1e-12).all()
            assert (env.command()[0] <= high + 1e-12).all()
            free = (env.command()[0] > low) & (env.command()[0] < high)
            aimed = np.tile(0.015 * action, (env.num_envs, 1))
            np.testing.assert_allclose(moved[free], aimed[free], atol=0.006)


def test_the_hand_does_before_a_known_displaced_box_what_it_does_before_one_in_place() -> None:
    """But for another posture of the same arm, which follows a little differently."""
    paths = {}
    for displacement in (None, (0.02, -0.012, 8.0)):
        env = batch(displacement, None if displacement is None else calibration_at(*displacement))
        env.reset()
        paths[displacement] = np.array(
            [env.step(np.tile(action, (2, 1))).observation for action in MOVES]
        )
    nominal, moved = paths.values()
    np.testing.assert_allclose(moved[..., :3], nominal[..., :3], atol=1e-3)
    np.testing.assert_allclose(moved[..., 3:], nominal[..., 3:], atol=1e-3)


def test_tilt_is_told_against_how_the_hand_is_held_before_the_known_box() -> None:
    displacement = (0.02, -0.012, 8.0)
    env = batch(displacement, calibration_at(*displacement))
    env.reset()
    for action in MOVES[:6]:
        env.step(np.tile(action, (env.num_envs, 1)))
        tilts = env.diagnostics().hand_tilt
        for k, qpos in enumerate(env.batch.bind("qpos")):
            _, turn = hand_by_mujoco(qpos[env.scene.arm_qpos], displacement)
            seen = np.linalg.norm(rotation_vector(turn.T @ HAND_DOWN))
            assert tilts[k] == pytest.approx(seen, abs=1e-6)


def test_what_is_known_changes_no_physics() -> None:
    known = ArmScene(ARM, (0.02, -0.012, 8.0))
    unknown = ArmScene(ARM)
    for field in ("body_pos", "body_quat", "geom_pos", "qpos0"):
        ours, theirs = (getattr(scene.model, field) for scene in (known, unknown))
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("calibration", [exact_calibration(), calibration_at(0.0, 0.0, 0.0)])
def test_a_box_that_nobody_looked_for_or_that_is_in_place_changes_no_bit(
    calibration: Calibration,
) -> None:
    scene = ArmScene(ARM, Known(calibration).displacement)
    q = np.random.default_rng(2).uniform(-1.0, 1.0, (50, 7))
    for ours, theirs in zip(scene.arm_pose(q), ArmScene(ARM).arm_pose(q), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    layout = ARM.layout()
    assert scene.placed(layout) == layout
    if calibration.servo is None:
        env, plain = batch(None, calibration), batch(None)
        np.testing.assert_array_equal(env.reset(), plain.reset())
        for action in MOVES:
            rows = np.tile(action, (2, 1))
            np.testing.assert_array_equal(env.step(rows).observation, plain.step(rows).observation)
            np.testing.assert_array_equal(env.servo_targets, plain.servo_targets)


def test_layout_and_its_hash_are_those_of_the_policy() -> None:
    env = batch(None, calibration_at(0.02, 0.0, 5.0))
    assert env.layout.hash() == ARM.layout().hash()


def test_stiffness_is_told_along_the_axes_of_the_box() -> None:
    """What moves the hand by e in the base frame is worth the same force in any axes."""
    soft = exact_calibration(np.array([0.2, 0.9, 0.4, 0.8, 0.3, 1.0, 0.7]), 1.0)  # type: ignore[arg-type]
    displacement = (0.02, -0.012, 8.0)
    known = Known(calibration_at(*displacement, servo=soft))
    workspace = workspace_of(ArmScene(ARM, known.displacement).placed(ARM.layout()))
    matrix = known.stiffness(workspace)
    assert matrix is not None
    from skewmi.robot_models.hand_stiffness import hand_stiffness

    servo = soft.servo
    assert servo is not None
    plain = hand_stiffness(np.array(servo.kp.value), np.array(workspace.start_configuration))
    turn = box_moved(displacement)[:3, :3]
    assert not np.allclose(matrix, plain, atol=1e-3), "nothing is turned: nothing is shown"
    for error in np.random.default_rng(3).normal(size=(5, 3)):
        np.testing.assert_allclose(turn @ (matrix @ error), plain @ (turn @ error), atol=1e-12)


def test_a_task_without_a_box_and_a_box_too_far_away_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="without that section"):
        ArmBatch(DOOR, 1, num_threads=1, calibration=calibration_at(0.01, 0.0, 0.0))
    with pytest.raises(ConfigurationError, match=r"\+60.000 mm along x"):
        ArmBatch(ARM, 1, num_threads=1, calibration=calibration_at(0.06, 0.0, 0.0))


def test_what_the_task_calls_its_box_is_the_middle_of_what_stands_there() -> None:
    """`calibrate scene` tells a turn about the middle of the footprint."""
    scene = ArmScene(ARM)
    assert ARM.box_origin(scene.model) == pytest.approx(ORIGIN)
    model, data = scene.model, mujoco.MjData(scene.model)
    mujoco.mj_kinematics(model, data)
    walls = [g for g in range(model.ngeom) if model.geom_bodyid[g] == model.body("box").id]
    low = np.min([data.geom_xpos[g] - model.geom_size[g] for g in walls], axis=0)
    high = np.max([data.geom_xpos[g] + model.geom_size[g] for g in walls], axis=0)
    middle = (low + high) / 2.0
    np.testing.assert_allclose(middle[:2], ORIGIN, atol=1e-12)
    np.testing.assert_array_equal(model.body("box").quat, (1.0, 0.0, 0.0, 0.0))


def test_a_motion_that_solves_the_task_solves_it_before_a_known_displaced_box() -> None:
    """And not before one that is where nobody knows."""
    displacement = (0.02, -0.012, 8.0)
    wins = {}
    for name, options in {
        "in place": {},
        "not known": {"variation": varied(displacement)},
        "known": {
            "variation": varied(displacement),
            "calibration": calibration_at(*displacement),
        },
    }.items():
        runs = ScriptedEpisodes(ARM, ScriptedOpenPressClose, 4, **options)
        wins[name] = int((runs.success_step > 0).sum())
    assert wins["in place"] == wins["known"] == NUM_ENVS
    assert wins["not known"] == 0
