"""Laws of the commanded hand position: box, leads, and what counts as held up."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from skewmi.errors import ConfigurationError
from skewmi.hand_command import EXPLAINED_DELAY, integrate_command, stalled
from skewmi.policy_io import ActionField, Array, Field, PolicyLayout, Workspace

WORKSPACE = Workspace(
    low=(-0.019, -0.155, 0.19),
    high=(0.001, 0.135, 0.355),
    start=(-0.009, -0.1345, 0.27),
    base_position=(-0.4, 0.0, 0.0),
    hand_quaternion_wxyz=(0.0, 1.0, 0.0, 0.0),
    free_lead=1.5,
    held_lead=0.4,
    stop_lead=0.6,
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


@given(positions, actions, positions, positions)
def test_command_stays_in_the_box(command: Array, action: Array, hand: Array, moved: Array) -> None:
    target = integrate_command(LAYOUT, command, action, hand, moved)
    assert (target >= WORKSPACE.low).all()
    assert (target <= WORKSPACE.high).all()


def in_actions(distance: Array) -> Array:
    """Length of distances in full actions. Shape (..., 3) -> (...)."""
    length: Array = np.linalg.norm(distance / LAYOUT.action_scale[:3], axis=-1)
    return length


@given(positions, actions, inside_box, positions)
def test_command_leads_the_hand_by_no_more_than_allowed(
    command: Array, action: Array, hand: Array, moved: Array
) -> None:
    """From inside the box, clipping to it only shortens the lead: a box is convex."""
    lead = integrate_command(LAYOUT, command, action, hand, moved) - hand
    assert (in_actions(lead) <= WORKSPACE.free_lead + 1e-9).all()


@given(positions, actions, inside_box)
def test_command_leads_a_hand_that_is_held_up_by_less(
    command: Array, action: Array, hand: Array
) -> None:
    lead = integrate_command(LAYOUT, command, action, hand, np.zeros(3)) - hand
    held = in_actions(command - hand) >= WORKSPACE.held_lead
    assert (in_actions(lead)[held] <= WORKSPACE.held_lead + 1e-9).all()


@given(inside_box, actions)
def test_command_against_an_obstacle_settles_at_the_smaller_lead(
    hand: Array, action: Array
) -> None:
    """However the policy pushes: a command that leads by more comes back at once."""
    command = hand
    for push in np.concatenate([action, action]):
        held = in_actions(command - hand) >= WORKSPACE.held_lead
        command = integrate_command(LAYOUT, command, push, hand, np.zeros(3))
        assert not held or in_actions(command - hand) <= WORKSPACE.held_lead + 1e-9


@given(inside_box, actions, st.floats(0.0, EXPLAINED_DELAY))
def test_a_late_arm_is_not_taken_for_one_that_is_held_up(
    hand: Array, action: Array, steps_late: float
) -> None:
    """An arm that is late and moves may be led as far as one that is on time."""
    moved = np.clip(action[0, :3], -1.0, 1.0) * LAYOUT.action_scale[:3]
    command = hand + steps_late * moved
    assert stalled(LAYOUT, command - hand, moved) <= 1e-12
    target = integrate_command(LAYOUT, command, action, hand, moved)
    lead = command + np.clip(action[:, :3], -1.0, 1.0) * LAYOUT.action_scale[:3] - hand
    shorter = np.minimum(1.0, WORKSPACE.free_lead / np.maximum(in_actions(lead), 1e-12))
    expected = np.clip(hand + lead * shorter[:, None], WORKSPACE.low, WORKSPACE.high)
    np.testing.assert_allclose(target, expected, atol=1e-9)


@given(positions, positions)
def test_a_hand_that_rests_stalls_by_all_of_its_error(error: Array, moved: Array) -> None:
    rest = stalled(LAYOUT, error, np.zeros(3))
    np.testing.assert_allclose(rest, in_actions(error))
    assert (stalled(LAYOUT, error, moved) <= rest).all()


@given(inside_box, st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4))
def test_small_step_from_the_hand_is_the_scaled_action(hand: Array, action: list[float]) -> None:
    small = 0.02 * np.array(action)
    target = integrate_command(LAYOUT, hand, small, hand, np.zeros(3))
    free = hand + small[:3] * LAYOUT.action_scale[:3]
    np.testing.assert_allclose(target, np.clip(free, WORKSPACE.low, WORKSPACE.high), atol=1e-15)


@given(positions, actions, positions, positions)
def test_command_clips_the_action_and_ignores_the_gripper(
    command: Array, action: Array, hand: Array, moved: Array
) -> None:
    target = integrate_command(LAYOUT, command, action, hand, moved)
    for same in (np.clip(action, -1.0, 1.0), action[:, :3]):
        again = integrate_command(LAYOUT, command, same, hand, moved)
        np.testing.assert_array_equal(again, target)


@given(positions, actions, positions, positions)
def test_command_of_a_batch_is_that_of_its_rows(
    command: Array, action: Array, hand: Array, moved: Array
) -> None:
    batch = integrate_command(LAYOUT, command, action, hand, moved)
    for i in range(len(batch)):
        row = integrate_command(LAYOUT, command[i], action[i], hand[i], moved[i])
        np.testing.assert_allclose(row, batch[i], rtol=0.0, atol=1e-15)


def test_command_needs_a_workspace() -> None:
    layout = dataclasses.replace(LAYOUT, workspace=None)
    with pytest.raises(ConfigurationError, match="workspace"):
        integrate_command(layout, np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(3))
