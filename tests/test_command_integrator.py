"""Laws of the commanded hand position: box, leads, and what counts as held up."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from skewmi.command_integrator import (
    EXPLAINED_DELAY,
    FADING,
    integrate_command,
    remembered_stall,
    stalled,
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


stalls = hnp.arrays(np.float64, 5, elements=st.floats(0.0, 3.0))


@given(positions, actions, positions, stalls)
def test_command_stays_in_the_box(command: Array, action: Array, hand: Array, stall: Array) -> None:
    target = integrate_command(LAYOUT, command, action, hand, stall)
    assert (target >= WORKSPACE.low).all()
    assert (target <= WORKSPACE.high).all()


def in_actions(distance: Array) -> Array:
    """Length of distances in full actions. Shape (..., 3) -> (...)."""
    length: Array = np.linalg.norm(distance / LAYOUT.action_scale[:3], axis=-1)
    return length


@given(positions, actions, inside_box, stalls)
def test_command_leads_the_hand_by_no_more_than_allowed(
    command: Array, action: Array, hand: Array, stall: Array
) -> None:
    """From inside the box, clipping to it only shortens the lead: a box is convex."""
    lead = in_actions(integrate_command(LAYOUT, command, action, hand, stall) - hand)
    assert (lead <= WORKSPACE.free_following_error + 1e-9).all()
    held = stall >= WORKSPACE.held_following_error
    assert (lead[held] <= WORKSPACE.held_following_error + 1e-9).all()


@given(positions, actions, inside_box, stalls, stalls)
def test_the_more_it_stalls_the_less_a_hand_is_led(
    command: Array, action: Array, hand: Array, less: Array, more: Array
) -> None:
    less, more = np.minimum(less, more), np.maximum(less, more)
    near, far = (integrate_command(LAYOUT, command, action, hand, x) - hand for x in (more, less))
    assert (in_actions(near) <= in_actions(far) + 1e-9).all()


@given(inside_box, actions)
def test_command_against_an_obstacle_settles_at_the_smaller_lead(
    hand: Array, action: Array
) -> None:
    """However the policy pushes: a command that leads by more comes back at once."""
    command, stall, rest = hand, np.array(0.0), np.zeros(3)
    for push in np.concatenate([action, action]):
        held = in_actions(command - hand) >= WORKSPACE.held_following_error
        stall = remembered_stall(LAYOUT, stall, command - hand, rest)
        command = integrate_command(LAYOUT, command, push, hand, stall)
        assert not held or in_actions(command - hand) <= WORKSPACE.held_following_error + 1e-9


@given(inside_box, actions, st.floats(0.0, EXPLAINED_DELAY))
def test_a_late_arm_is_not_taken_for_one_that_is_held_up(
    hand: Array, action: Array, steps_late: float
) -> None:
    moved = np.clip(action[0, :3], -1.0, 1.0) * LAYOUT.action_scale[:3]
    error = steps_late * moved
    assert stalled(LAYOUT, error, moved) <= 1e-12
    assert remembered_stall(LAYOUT, np.array(0.0), error, moved) <= 1e-12


@given(positions, positions)
def test_a_hand_that_rests_stalls_by_all_of_its_error(error: Array, moved: Array) -> None:
    rest = stalled(LAYOUT, error, np.zeros(3))
    np.testing.assert_allclose(rest, in_actions(error))
    assert (stalled(LAYOUT, error, moved) <= rest).all()


@given(st.floats(0.0, 3.0), st.floats(0.0, 1.0))
def test_a_stall_is_remembered_until_the_hand_moves(stall: float, moved: float) -> None:
    """Of a hand that is where it is commanded to be."""
    nowhere = np.zeros(3)
    at_rest = remembered_stall(LAYOUT, np.array(stall), nowhere, nowhere)
    assert at_rest == pytest.approx(FADING * stall)
    travel = np.array([0.0, moved, 0.0]) * LAYOUT.action_scale[:3]
    moving = remembered_stall(LAYOUT, np.array(stall), nowhere, travel)
    assert moving == pytest.approx(max(FADING * stall - moved, 0.0))


@given(inside_box, st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4))
def test_small_step_from_the_hand_is_the_scaled_action(hand: Array, action: list[float]) -> None:
    small = 0.02 * np.array(action)
    target = integrate_command(LAYOUT, hand, small, hand, 0.0)
    free = hand + small[:3] * LAYOUT.action_scale[:3]
    np.testing.assert_allclose(target, np.clip(free, WORKSPACE.low, WORKSPACE.high), atol=1e-15)


@given(positions, actions, positions, stalls)
def test_command_clips_the_action_and_ignores_the_gripper(
    command: Array, action: Array, hand: Array, stall: Array
) -> None:
    target = integrate_command(LAYOUT, command, action, hand, stall)
    for same in (np.clip(action, -1.0, 1.0), action[:, :3]):
        again = integrate_command(LAYOUT, command, same, hand, stall)
        np.testing.assert_array_equal(again, target)


@given(positions, actions, positions, stalls)
def test_command_of_a_batch_is_that_of_its_rows(
    command: Array, action: Array, hand: Array, stall: Array
) -> None:
    batch = integrate_command(LAYOUT, command, action, hand, stall)
    for i in range(len(batch)):
        row = integrate_command(LAYOUT, command[i], action[i], hand[i], stall[i])
        np.testing.assert_allclose(row, batch[i], rtol=0.0, atol=1e-15)


def test_command_needs_a_workspace() -> None:
    layout = dataclasses.replace(LAYOUT, workspace=None)
    with pytest.raises(ConfigurationError, match="workspace"):
        integrate_command(layout, np.zeros(3), np.zeros(4), np.zeros(3), 0.0)
