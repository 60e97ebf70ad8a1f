"""Laws of the commanded hand: box, following error, what counts as blocked."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from skewmi.command_integrator import (
    EXPLAINED_DELAY,
    FADING,
    SOFTEST,
    CommandIntegrator,
    next_position,
    present_blockage,
    remembered_blockage,
)
from skewmi.errors import ConfigurationError
from skewmi.policy_io import ActionField, Array, Field, PolicyLayout, Workspace

WORKSPACE = Workspace(
    low=(-0.019, -0.155, 0.19),
    high=(0.001, 0.135, 0.355),
    start=(-0.009, -0.1345, 0.27),
    base_position=(-0.4, 0.0, 0.0),
    hand_quaternion_wxyz=(0.0, 1.0, 0.0, 0.0),
    free_following_error=1.5,
    held_following_error=0.4,
    stop_blockage=0.6,
    start_configuration=(0.0,) * 7,
    gripper_opening=0.014,
)
LAYOUT = PolicyLayout(
    task="box",
    observation=(Field("hand_x", "m", "world", -0.019, 0.001),),
    action=(
        ActionField("hand_x", "m/step", "world", 0.005),
        ActionField("hand_y", "m/step", "world", 0.015),
        ActionField("hand_z", "m/step", "world", 0.3),
        ActionField("gripper", "m/step", "finger", 0.0025),
    ),
    reward_region=(),
    control_dt=0.1,
    episode_steps=200,
    success_hold_steps=10,
    workspace=WORKSPACE,
)

positions = hnp.arrays(np.float64, (5, 3), elements=st.floats(-0.5, 0.5))
actions = hnp.arrays(np.float64, (5, 4), elements=st.floats(-3.0, 3.0))
inside_box = st.tuples(
    *(st.floats(low, high) for low, high in zip(WORKSPACE.low, WORKSPACE.high, strict=True))
).map(np.array)


blockages = hnp.arrays(np.float64, 5, elements=st.floats(0.0, 3.0))


@settings(deadline=None)
@given(positions, actions, positions, blockages)
def test_command_stays_in_the_box(
    command: Array, action: Array, hand: Array, blockage: Array
) -> None:
    target = next_position(LAYOUT, command, action, hand, blockage)
    assert (target >= WORKSPACE.low).all()
    assert (target <= WORKSPACE.high).all()


def in_actions(distance: Array) -> Array:
    """Length of distances in full actions. Shape (..., 3) -> (...)."""
    length: Array = np.linalg.norm(distance / LAYOUT.action_scale[:3], axis=-1)
    return length


@settings(deadline=None)
@given(positions, actions, inside_box, blockages)
def test_the_following_error_is_no_more_than_allowed(
    command: Array, action: Array, hand: Array, blockage: Array
) -> None:
    """From inside the box, clipping to it only shortens the error: a box is convex."""
    error = in_actions(next_position(LAYOUT, command, action, hand, blockage) - hand)
    assert (error <= WORKSPACE.free_following_error + 1e-9).all()
    held = blockage >= WORKSPACE.held_following_error
    assert (error[held] <= WORKSPACE.held_following_error + 1e-9).all()


@settings(deadline=None)
@given(positions, actions, inside_box, blockages, blockages)
def test_the_more_a_hand_is_blocked_the_less_its_command_is_ahead(
    command: Array, action: Array, hand: Array, less: Array, more: Array
) -> None:
    less, more = np.minimum(less, more), np.maximum(less, more)
    near, far = (next_position(LAYOUT, command, action, hand, x) - hand for x in (more, less))
    assert (in_actions(near) <= in_actions(far) + 1e-9).all()


@settings(deadline=None)
@given(inside_box, actions)
def test_command_against_an_obstacle_settles_at_the_smaller_lead(
    hand: Array, action: Array
) -> None:
    """However the policy pushes: a command that is further ahead comes back at once."""
    command, blockage, rest = hand, np.array(0.0), np.zeros(3)
    for push in np.concatenate([action, action]):
        held = in_actions(command - hand) >= WORKSPACE.held_following_error
        blockage = remembered_blockage(LAYOUT, blockage, command - hand, rest)
        command = next_position(LAYOUT, command, push, hand, blockage)
        assert not held or in_actions(command - hand) <= WORKSPACE.held_following_error + 1e-9


@settings(deadline=None)
@given(inside_box, actions, st.floats(0.0, EXPLAINED_DELAY))
def test_a_late_arm_is_not_taken_for_a_blocked_one(
    hand: Array, action: Array, steps_late: float
) -> None:
    moved = np.clip(action[0, :3], -1.0, 1.0) * LAYOUT.action_scale[:3]
    error = steps_late * moved
    assert present_blockage(LAYOUT, error, moved) <= 1e-12
    assert remembered_blockage(LAYOUT, np.array(0.0), error, moved) <= 1e-12


@settings(deadline=None)
@given(positions, positions)
def test_a_hand_that_rests_is_blocked_by_all_of_its_error(error: Array, moved: Array) -> None:
    rest = present_blockage(LAYOUT, error, np.zeros(3))
    np.testing.assert_allclose(rest, in_actions(error))
    assert (present_blockage(LAYOUT, error, moved) <= rest).all()


@settings(deadline=None)
@given(st.floats(0.0, 3.0), st.floats(0.0, 1.0))
def test_a_blockage_is_remembered_until_the_hand_moves(blockage: float, moved: float) -> None:
    """Of a hand that is where it is commanded to be."""
    nowhere = np.zeros(3)
    at_rest = remembered_blockage(LAYOUT, np.array(blockage), nowhere, nowhere)
    assert at_rest == pytest.approx(FADING * blockage)
    travel = np.array([0.0, moved, 0.0]) * LAYOUT.action_scale[:3]
    moving = remembered_blockage(LAYOUT, np.array(blockage), nowhere, travel)
    assert moving == pytest.approx(max(FADING * blockage - moved, 0.0))


@settings(deadline=None)
@given(inside_box, st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4))
def test_small_step_from_the_hand_is_the_scaled_action(hand: Array, action: list[float]) -> None:
    small = 0.02 * np.array(action)
    target = next_position(LAYOUT, hand, small, hand, 0.0)
    free = hand + small[:3] * LAYOUT.action_scale[:3]
    np.testing.assert_allclose(target, np.clip(free, WORKSPACE.low, WORKSPACE.high), atol=1e-15)


@settings(deadline=None)
@given(positions, actions, positions, blockages)
def test_command_clips_the_action_and_ignores_the_gripper(
    command: Array, action: Array, hand: Array, blockage: Array
) -> None:
    target = next_position(LAYOUT, command, action, hand, blockage)
    for same in (np.clip(action, -1.0, 1.0), action[:, :3]):
        again = next_position(LAYOUT, command, same, hand, blockage)
        np.testing.assert_array_equal(again, target)


@settings(deadline=None)
@given(positions, actions, positions, blockages)
def test_command_of_a_batch_is_that_of_its_rows(
    command: Array, action: Array, hand: Array, blockage: Array
) -> None:
    batch = next_position(LAYOUT, command, action, hand, blockage)
    for i in range(len(batch)):
        row = next_position(LAYOUT, command[i], action[i], hand[i], blockage[i])
        np.testing.assert_allclose(row, batch[i], rtol=0.0, atol=1e-15)


def test_command_needs_a_workspace() -> None:
    layout = dataclasses.replace(LAYOUT, workspace=None)
    with pytest.raises(ConfigurationError, match="workspace"):
        next_position(layout, np.zeros(3), np.zeros(4), np.zeros(3), 0.0)


stiffnesses = hnp.arrays(np.float64, (3, 3), elements=st.floats(-1.5, 1.5))


@settings(deadline=None)
@given(positions, actions, inside_box, blockages, stiffnesses)
def test_whatever_is_known_the_command_is_no_less_and_three_times_as_far_ahead_at_most(
    command: Array, action: Array, hand: Array, blockage: Array, stiffness: Array
) -> None:
    wide = dataclasses.replace(
        LAYOUT, workspace=dataclasses.replace(WORKSPACE, low=(-9.0,) * 3, high=(9.0,) * 3)
    )
    plain, known = (
        in_actions(next_position(wide, command, action, hand, blockage, m) - hand)
        for m in (None, stiffness)
    )
    assert (known >= plain - 1e-9).all()
    assert (known <= SOFTEST * plain + 1e-9).all()


@settings(deadline=None)
@given(inside_box, actions, st.floats(1.0 / SOFTEST, 1.0))
@example(np.array([0.0, 0.0, 0.25]), np.full((5, 4), 0.01953125), 0.5)
def test_a_soft_arm_pushes_an_obstacle_as_hard_as_training_s(
    hand: Array, action: Array, ratio: float
) -> None:
    """A blocked hand of springs, either arm: one force, and it comes back from more at once.

    The example is a slow push that is further ahead than it may just when twelve steps end: it
    has not settled, as no arm is held back before the step that follows.
    """
    wide = dataclasses.replace(
        LAYOUT, workspace=dataclasses.replace(WORKSPACE, low=(-9.0,) * 3, high=(9.0,) * 3)
    )
    held, histories = WORKSPACE.held_following_error, []
    for spring, known in ((1.0, None), (ratio, ratio * np.eye(3))):
        integrator = CommandIntegrator(wide, 0.025, known)
        integrator.start(hand[None])
        force = []
        for _ in range(12):
            integrator.begin_step(action[:1] / spring, hand[None])
            force.append(in_actions(spring * (integrator.position_w - hand))[0])
        histories.append(np.array(force))
        more = histories[-1][:-1] >= held
        assert (histories[-1][1:][more] <= held + 1e-9).all()
    training, soft = histories
    if (np.abs(action[0, :3]) <= ratio).all():  # neither action is clipped
        np.testing.assert_allclose(soft, training, rtol=1e-6, atol=1e-12)
    if (training[:-1] >= held).any() and (soft[:-1] >= held).any():
        np.testing.assert_allclose(soft[-1], training[-1], rtol=1e-6)


@settings(deadline=None)
@given(positions, actions, positions, blockages)
def test_the_arm_of_training_changes_nothing(
    command: Array, action: Array, hand: Array, blockage: Array
) -> None:
    known, plain = (
        next_position(LAYOUT, command, action, hand, blockage, m) for m in (np.eye(3), None)
    )
    np.testing.assert_allclose(known, plain, rtol=0, atol=1e-12)
