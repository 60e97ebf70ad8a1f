"""Laws of the line of a control step: where it ends, what is remembered, and the fingers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from skewmi.command_integrator import CommandIntegrator
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array
from skewmi.sim.tasks.open_press_close.definition import make_layout

LAYOUT = make_layout(gripper_action=True)
assert LAYOUT.workspace is not None
WORKSPACE = LAYOUT.workspace
TRAVEL = 0.025

seeds = st.integers(0, 2**32 - 1)
pushes = hnp.arrays(np.float64, (8, 3, 4), elements=st.floats(-1.5, 1.5))


def moving_hands(seed: int, n: int, looks: int) -> Array:
    """Hands that walk about the box and rest now and then. Shape (looks, n, 3)."""
    rng = np.random.default_rng(seed)
    moves = rng.uniform(-1.0, 1.0, (looks, n, 3)) * LAYOUT.action_scale[:3]
    rests = rng.random((looks // 5 + 1, n, 1)).repeat(5, axis=0)[:looks] < 0.5
    return np.array(WORKSPACE.start) + np.cumsum(np.where(rests, 0.0, 0.3 * moves), axis=0)


def drive(hands: Array, pushes: Array) -> tuple[CommandIntegrator, list[tuple[Array, ...]]]:
    """Steps of five looks 20 ms apart, as both users make them; what was commanded at each."""
    integrator, seen = CommandIntegrator(LAYOUT, TRAVEL), []
    integrator.start(hands[0])
    for look, hand in enumerate(hands):
        if look % 5 == 0:
            integrator.begin_step(pushes[look // 5], hand)
            held = np.empty(0, dtype=np.int64)
        else:
            held = integrator.watch(hand, look % 5 * 20_000_000)
        marks = np.isin(np.arange(len(hand)), held)
        seen.append((integrator.position_w, integrator.blockage.copy(), integrator.opening, marks))
    return integrator, seen


@settings(deadline=None, max_examples=30)
@given(seeds, pushes)
def test_commands_of_a_batch_are_to_the_digit_those_of_its_rows(seed: int, push: Array) -> None:
    hands = moving_hands(seed, 3, 40)
    _, batch = drive(hands, push)
    for row in range(3):
        _, single = drive(hands[:, row : row + 1], push[:, row : row + 1])
        for ours, theirs in zip(single, batch, strict=True):
            for one, many in zip(ours, theirs, strict=True):
                np.testing.assert_array_equal(one[0], many[row])


@settings(deadline=None, max_examples=30)
@given(seeds, pushes)
def test_commands_stay_in_the_box_and_fingers_in_their_range(seed: int, push: Array) -> None:
    for position, blockage, opening, _ in drive(moving_hands(seed, 3, 40), push)[1]:
        assert (position >= WORKSPACE.low).all()
        assert (position <= WORKSPACE.high).all()
        assert (blockage >= 0.0).all()
        assert (opening >= 0.0).all()
        assert (opening <= TRAVEL).all()


@settings(deadline=None, max_examples=30)
@given(seeds, pushes)
def test_a_line_ends_once_and_then_the_command_stands(seed: int, push: Array) -> None:
    hands = moving_hands(seed, 3, 40)
    seen = drive(hands, push)[1]
    for step in range(8):
        looks = seen[5 * step : 5 * step + 5]
        ends = np.array([marks for *_, marks in looks])
        assert (ends.sum(axis=0) <= 1).all()
        for before, after, now, hand in zip(
            looks, looks[1:], ends[1:], hands[5 * step + 1 :], strict=False
        ):
            np.testing.assert_array_equal(after[0][~now], before[0][~now])
            np.testing.assert_array_equal(after[1][~now], before[1][~now])
            # Where it ends, it ends for a blockage, and nearer to the hand than it would have.
            assert (after[1][now] > WORKSPACE.stop_blockage).all()
            distances = [np.linalg.norm(x[0][now] - hand[now], axis=-1) for x in (before, after)]
            assert (distances[1] < distances[0]).all()


def test_a_blocked_hand_ends_the_line_where_the_command_is_then() -> None:
    start = np.array([WORKSPACE.start])
    integrator = CommandIntegrator(LAYOUT, TRAVEL)
    integrator.start(start)
    integrator.begin_step(np.array([[0.0, 1.0, 0.0, 1.0]]), start)
    full = integrator.position_w
    np.testing.assert_allclose(full - start, [[0.0, 0.015, 0.0]])
    for since_ns in (20_000_000, 40_000_000):
        assert integrator.watch(start, since_ns).size == 0
    assert integrator.watch(start, 80_000_000).tolist() == [0]
    np.testing.assert_allclose(integrator.position_w, start + 0.8 * (full - start))
    np.testing.assert_allclose(integrator.blockage, 0.8)
    np.testing.assert_allclose(integrator.opening, WORKSPACE.gripper_opening + 0.0025)


def test_a_look_that_is_not_newer_ends_nothing() -> None:
    start = np.array([WORKSPACE.start])
    integrator = CommandIntegrator(LAYOUT, TRAVEL)
    integrator.start(start)
    assert integrator.watch(start + 1.0, 20_000_000).size == 0  # nothing moves yet
    integrator.begin_step(np.array([[0.0, 1.0, 0.0, 0.0]]), start)
    far = start - [[0.0, 0.1, 0.0]]
    assert integrator.watch(far, 0).size == 0
    assert integrator.watch(start, 20_000_000).size == 0
    assert integrator.watch(far, 20_000_000).size == 0


def test_motion_under_way_is_no_following_error() -> None:
    """An arm that is a full action late by its planner only gets the whole of the next one."""
    start = np.array([WORKSPACE.start])
    integrator = CommandIntegrator(LAYOUT, TRAVEL)
    integrator.start(start)
    push, along = np.array([[0.0, 1.0, 0.0, 0.0]]), np.array([[0.0, 0.015, 0.0]])
    for step in range(1, 4):
        hand = start + along * max(step - 2, 0)
        integrator.begin_step(push, hand, ahead_w=integrator.position_w)
        np.testing.assert_allclose(integrator.position_w, start + along * step)
        assert integrator.blockage[0] == 0.0
        commanded = start + along * max(step - 1.8, 0.0)
        assert integrator.watch(hand, 20_000_000, commanded_w=commanded).size == 0


def test_a_command_that_goes_on_from_elsewhere_keeps_fingers_and_blockage() -> None:
    start = np.array([WORKSPACE.start])
    integrator = CommandIntegrator(LAYOUT, TRAVEL)
    integrator.start(start)
    integrator.begin_step(np.array([[0.0, 1.0, 0.0, 1.0]]), start)
    assert integrator.watch(start, 80_000_000).tolist() == [0]
    opening, blockage = integrator.opening, integrator.blockage
    integrator.resume(start)
    np.testing.assert_array_equal(integrator.position_w, start)
    np.testing.assert_array_equal(integrator.opening, opening)
    np.testing.assert_array_equal(integrator.blockage, blockage)
    assert integrator.watch(start - 0.1, 100_000_000).size == 0
    integrator.start(start)
    assert integrator.blockage[0] == 0.0
    assert integrator.opening[0] == WORKSPACE.gripper_opening


def test_without_a_gripper_action_the_fingers_keep_their_opening() -> None:
    integrator = CommandIntegrator(dataclasses.replace(LAYOUT, action=LAYOUT.action[:3]), TRAVEL)
    start = np.array([WORKSPACE.start])
    integrator.start(start)
    integrator.begin_step(np.array([[0.0, 1.0, 0.0]]), start)
    assert not integrator.moves_gripper
    assert integrator.opening[0] == WORKSPACE.gripper_opening


def test_an_integrator_needs_a_workspace() -> None:
    with pytest.raises(ConfigurationError, match="workspace"):
        CommandIntegrator(dataclasses.replace(LAYOUT, workspace=None), TRAVEL)


def lines_against_a_wall(speed: float, coming: float) -> float:
    """Error at which the line of a hand ends that has met a wall while the command goes on, m."""
    integrator = CommandIntegrator(LAYOUT, TRAVEL)
    hand = np.array([WORKSPACE.start])
    integrator.start(hand)
    push = np.array([[0.0, speed, 0.0, 0.0]])
    # The first line it may follow; into the second the wall comes.
    integrator.begin_step(push, hand)
    hand = integrator.position_w.copy()
    integrator.begin_step(push, hand)
    for look in range(1, 5):
        done = look * 20_000_000 / round(LAYOUT.control_dt * 1e9)
        error = done * (integrator.position_w - integrator.begin_w)
        held = integrator.watch(
            hand, look * 20_000_000, coming_error_w=coming * np.array([[0.0, 1.0, 0.0]])
        )
        if held.size:
            return float(np.linalg.norm(error))
    return float("inf")


@given(st.floats(0.7, 1.0), st.floats(0.0, 0.005), st.floats(0.0, 0.005))
def test_a_line_ends_the_sooner_the_more_error_is_still_to_come(
    speed: float, coming: float, more: float
) -> None:
    bound = WORKSPACE.stop_blockage * LAYOUT.action_scale[1]
    error = lines_against_a_wall(speed, coming)
    assert lines_against_a_wall(speed, coming + more) <= error
    # The hand stands still: what it is behind, with what is to come, has just passed the bound.
    step = speed * LAYOUT.action_scale[1] * 0.2
    assert bound < error + coming <= bound + step + 1e-12 or error == np.inf
