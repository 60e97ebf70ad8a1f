"""Command path of OpenPressClose: what hand, box and contact make of actions."""

from __future__ import annotations

import numpy as np
import pytest

from skewmi.errors import ConfigurationError
from skewmi.robot_models import frames, kinematics
from skewmi.sim.arm import definition as arm_definition
from skewmi.sim.arm.batch import ArmBatch
from skewmi.sim.arm.randomization import Randomization
from skewmi.sim.arm.reach import HAND_MARGIN, reachable
from skewmi.sim.arm.scene import workspace_of
from skewmi.sim.tasks.open_press_close import definition, parts
from skewmi.sim.tasks.open_press_close.definition import ARM
from skewmi.success import inside_region

LAYOUT = definition.make_layout()


WORKSPACE = workspace_of(LAYOUT)


@pytest.fixture(scope="module")
def shaken() -> dict[str, np.ndarray]:
    """Every environment under its own slowly varying random actions, through contact."""
    env = ArmBatch(ARM, 16, num_threads=1, seed=3)
    rng = np.random.default_rng(3)
    record: dict[str, list[np.ndarray]] = {
        name: [] for name in ("state", "speed", "command", "command_q", "tilt", "force")
    }
    env.reset()
    action = np.zeros((16, 3))
    for _ in range(LAYOUT.episode_steps):
        action = 0.85 * action + 0.5 * rng.standard_normal((16, 3))
        result = env.step(np.clip(action, -1.0, 1.0))
        diagnostics = env.diagnostics()
        command, command_q = env.command()
        record["state"].append(result.observation)
        record["speed"].append(np.abs(env.batch.bind("qvel")).max(axis=1))
        record["command"].append(command)
        record["command_q"].append(command_q)
        record["tilt"].append(diagnostics.hand_tilt)
        record["force"].append(diagnostics.hand_force_mean)
    return {name: np.array(values) for name, values in record.items()}


def test_random_actions_meet_contact(shaken) -> None:
    assert (shaken["force"] > 10.0).mean() > 0.02


def test_the_command_never_leaves_the_box(shaken) -> None:
    assert np.all(shaken["command"] >= np.array(WORKSPACE.low) - 1e-12)
    assert np.all(shaken["command"] <= np.array(WORKSPACE.high) + 1e-12)


def test_inverse_kinematics_is_exact_on_the_commanded_path(shaken) -> None:
    position, rotation = kinematics.ArmKinematics("right").forward(shaken["command_q"])
    error = np.linalg.norm(position + frames.BASE_IN_WORLD - shaken["command"], axis=-1)
    # A command that waits for the hand ends on a chord in joint space; all others are exact.
    assert error.max() < 2e-4
    assert np.quantile(error, 0.9) < 2e-5
    cosine = np.einsum("...ij,ij->...", rotation, frames.HAND_DOWN) / 2 - 0.5
    assert np.degrees(np.arccos(np.clip(cosine.min(), -1, 1))) < 0.05


def test_random_actions_stay_physical(shaken) -> None:
    assert np.isfinite(shaken["state"]).all()
    # The rating of the fastest joint is 7 rad/s; the lid, hit by a finger, is faster.
    assert shaken["speed"].max() < 30.0
    lid, button = shaken["state"][..., 4], shaken["state"][..., 5]
    assert lid.min() > -1e-2
    assert lid.max() < parts.LID_MAX + 0.02
    assert button.min() > -1e-3
    assert button.max() < parts.BUTTON_TRAVEL + 1e-3


def test_contact_pushes_the_hand_out_of_its_box_by_less_than_its_margin(shaken) -> None:
    hand = shaken["state"][..., :3]
    outside = np.maximum(np.array(WORKSPACE.low) - hand, hand - np.array(WORKSPACE.high))
    assert outside.max() < HAND_MARGIN
    # Without contact it stays inside.
    free = shaken["force"] < 1.0
    assert np.quantile(outside.max(axis=-1)[free], 0.99) < 0.003


def test_contact_hardly_tilts_the_hand(shaken) -> None:
    tilt = np.degrees(shaken["tilt"])
    assert np.quantile(tilt, 0.99) < 4.0
    assert tilt.max() < 8.0


def test_states_under_random_actions_count_as_reachable(shaken) -> None:
    assert reachable(ARM, LAYOUT, shaken["state"]).all()


def test_fingertips_below_a_shut_lid_are_not_reachable() -> None:
    state = np.array([-0.009, -0.08, 0.195, 0.014, 0.0, 0.0])
    assert not reachable(ARM, LAYOUT, state)
    assert reachable(ARM, LAYOUT, state + np.array([0, 0, 0, 0, 2.0, 0.015]))
    assert reachable(ARM, LAYOUT, state + np.array([0, 0, 0.03, 0, 0, 0.015]))


def test_a_free_hand_follows_its_command_without_lag() -> None:
    env = ArmBatch(ARM, 1, num_threads=1, randomization=Randomization((0.0, 0.0, 0.0)))
    env.reset()
    for _ in range(5):
        env.step(np.array([[0.0, 0.0, 1.0]]))
    assert env.diagnostics().hand_to_command[0] < 1.5e-3
    assert env.diagnostics().hand_force_peak[0] == 0.0


def test_a_blocked_hand_keeps_its_command_near_and_its_force_is_bounded() -> None:
    env = ArmBatch(ARM, 1, num_threads=1, randomization=Randomization((0.0, 0.0, 0.0)))
    env.reset()
    for _ in range(5):
        env.step(np.array([[0.0, 1.0, 0.0]]))
    forces, errors = [], []
    for _ in range(40):
        env.step(np.array([[0.0, 0.0, -1.0]]))
        forces.append(env.diagnostics().hand_force_mean[0])
        errors.append(env.diagnostics().hand_to_command[0])
    assert 5.0 < forces[-1] < 40.0
    assert forces[-1] < forces[-10] + 2.0
    # The following error is bounded where a step begins; contact moves the hand while it runs.
    assert errors[-1] < WORKSPACE.held_following_error * arm_definition.HAND_STEP + 1e-3


def test_the_command_waits_within_the_step_for_a_blocked_hand() -> None:
    """Pushed down onto the lid at full speed: the error at first contact is no full action."""
    env = ArmBatch(ARM, 1, num_threads=1, randomization=Randomization((0.0, 0.0, 0.0)))
    env.reset()
    for _ in range(5):
        env.step(np.array([[0.0, 1.0, 0.0]]))
    errors, moved = [], []
    for _ in range(10):
        before = env.command()[0][0, 2]
        env.step(np.array([[0.0, 0.0, -1.0]]))
        errors.append(env.diagnostics().hand_to_command[0])
        moved.append(before - env.command()[0][0, 2])
    # Without that it would be a full action when the step ends.
    assert max(errors) < 0.8 * arm_definition.HAND_STEP
    assert max(moved) == pytest.approx(
        arm_definition.HAND_STEP, abs=1e-6
    )  # until there was contact
    q = env.command()[1]
    position, _ = env.scene.kinematics.forward(q)
    np.testing.assert_allclose(
        position + frames.BASE_IN_WORLD, env.command()[0], atol=1e-4
    )  # the shortened command is one of joints, too


@pytest.mark.parametrize(("delay_ms", "share"), [(0.0, 0.85), (20.0, 0.5)])
def test_a_command_in_free_air_hardly_waits(tmp_path, delay_ms: float, share: float) -> None:
    variation = tmp_path / "late.yaml"
    variation.write_text(f"servo: {{delay_ms: {delay_ms}}}")
    env = ArmBatch(ARM, 1, num_threads=1, variation=variation)
    env.reset(0)
    for _ in range(8):  # up and clear of the lid
        env.step(np.array([[0.0, 0.0, 0.7]]))
    for action in ([0, 1, 0], [0, -1, 0], [0.5, 0.7, -0.5], [-0.5, -0.7, 0.5]):
        begin = env.command()[0][0]
        for _ in range(4):
            env.step(np.array([action], dtype=float))
        way = np.linalg.norm(env.command()[0][0] - begin)
        # A reversal costs a part of its first step, because the hand is still on its way.
        asked = 4 * arm_definition.HAND_STEP * np.linalg.norm(action)
        assert share * asked < way < asked + 1e-9


def test_the_gripper_action_moves_the_fingers_at_their_speed() -> None:
    env = ArmBatch(ARM, 2, num_threads=1, gripper_action=True)
    opening = env.reset()[:, 3]
    np.testing.assert_allclose(opening, definition.GRIPPER_OPENING, atol=1e-9)
    action = np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, -1.0]])
    for _ in range(3):
        result = env.step(action)
    moved = result.observation[:, 3] - opening
    np.testing.assert_allclose(moved, [0.0075, -0.0075], atol=1.5e-3)


def test_without_randomization_all_starts_are_the_layouts() -> None:
    env = ArmBatch(ARM, 3, num_threads=1, randomization=Randomization((0.0, 0.0, 0.0)))
    observation = env.reset()
    np.testing.assert_allclose(observation[:, :3], np.tile(WORKSPACE.start, (3, 1)), atol=1e-6)


def test_starts_vary_within_the_offset() -> None:
    env = ArmBatch(ARM, 64, num_threads=1)
    offset = env.reset(5)[:, :3] - np.array(WORKSPACE.start)
    assert np.abs(offset).max() <= 0.005 + 1e-6
    assert np.all(np.abs(offset).max(axis=0) > 0.004)


@pytest.mark.parametrize("offset", [(-0.001, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.0)])
def test_impossible_start_offsets_are_refused(offset) -> None:
    with pytest.raises(ConfigurationError, match="start_offset"):
        Randomization(offset)


@pytest.mark.parametrize(
    ("lid", "button", "inside"),
    [
        (0.0, 0.02, True),
        (0.0, 0.0101, True),
        (0.0, 0.0099, False),
        (0.034, 0.02, True),
        (0.036, 0.02, False),
        (2.0, 0.02, False),
        (0.0, 0.0, False),
    ],
)
def test_the_reward_region_is_shut_and_pressed(lid: float, button: float, inside: bool) -> None:
    assert inside_region(LAYOUT, np.array([0.0, 0.0, 0.27, 0.014, lid, button])) == inside
