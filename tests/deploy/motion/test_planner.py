"""The planner: exact splices, stops that always exist, paths that follow the command."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from planned_runs import KINEMATICS, START, follow

from skewmi.deploy.motion.cartesian_shaper import FEEDBACK_GAIN
from skewmi.deploy.motion.planner import Planner
from skewmi.errors import ConfigurationError, KinematicsError, LimitViolationError
from skewmi.policy_io import Workspace
from skewmi.robot_models import frames, limits, yumi
from skewmi.robot_models.frames import rotation_vector


def test_chunks_join_exactly_and_end_at_rest(planner: Planner) -> None:
    rng = np.random.default_rng(0)
    previous = planner.step(0)
    np.testing.assert_array_equal(previous.q[0], START)
    for cycle in range(60):
        if cycle % 5 == 0:
            planner.set_target(rng.uniform(planner.workspace.low, planner.workspace.high), 0.1)
        chunk = planner.step()
        for mine, expected in zip((chunk.q, chunk.v, chunk.a), previous.point(5), strict=True):
            np.testing.assert_array_equal(mine[0], expected)
        assert len(chunk.q) > 5
        assert not chunk.v[-1].any()
        assert not chunk.a[-1].any()
        previous = chunk


@pytest.mark.parametrize("late", [6, 8, 10, 15, 200])
def test_late_splice_goes_on_from_the_braking_arm(planner: Planner, late: int) -> None:
    goal = np.array(planner.workspace.start) + np.array([0.0, 0.1, 0.0])
    planner.set_target(goal, 0.7)
    for _ in range(15):
        chunk = planner.step()
    later = planner.step(late)
    for mine, expected in zip((later.q, later.v, later.a), chunk.point(late), strict=True):
        np.testing.assert_array_equal(mine[0], expected)
    # The command has gone on meanwhile, and the hand gets there.
    run = follow(planner, [], settle_cycles=100)
    np.testing.assert_allclose(run.hand_w[-1], goal, atol=2e-4)


def test_a_silent_policy_comes_to_rest_at_the_command(planner: Planner) -> None:
    target = np.array(planner.workspace.start) + np.array([0.005, 0.03, 0.02])
    run = follow(planner, [target], settle_cycles=75)
    np.testing.assert_allclose(run.hand_w[-1], target, atol=5e-5)
    # The joints may still drift towards the posture, the hand may not.
    assert np.abs(np.diff(run.hand_w[-10:], axis=0)).max() < 1e-6
    assert np.abs(np.diff(run.q[-10:], axis=0)).max() < 1e-5


def test_a_held_hand_stops_at_once_and_comes_back_slowly(planner: Planner) -> None:
    start = np.array(planner.workspace.start)
    for k in range(3):
        planner.set_target(start + np.array([0.0, 0.015 * (k + 1), 0.0]), 0.1)
        chunks = [planner.step() for _ in range(5)]
    at = planner.forward(chunks[-1].q[5])[0]
    held = at - np.array([0.0, 0.003, 0.0])
    planner.hold(held)
    way = np.concatenate([planner.forward(planner.step().q[1:6])[0] for _ in range(100)])
    beyond = way[:, 1] - at[1]
    # A stop from 150 mm/s takes 2 sqrt(v / J) with the bounds of the hand, at half of v on average.
    stop = 0.15 * np.sqrt(0.15 / planner.hand_bounds.jerk)
    assert beyond.max() < stop + 1e-3
    # By the feedback alone.
    assert np.diff(way[:, 1]).min() > -FEEDBACK_GAIN * (stop + 0.003) * 0.004
    np.testing.assert_allclose(way[-1], held, atol=1e-4)


def test_does_not_drift_over_a_long_way(planner: Planner) -> None:
    """Back and forth through the box: no error accumulates, and the posture comes back."""
    low, high = np.array(planner.workspace.low), np.array(planner.workspace.high)
    start = np.array(planner.workspace.start)
    corners = [low, high, np.array([low[0], high[1], low[2]]), start]
    for _ in range(2):
        for corner in corners:
            planner.set_target(corner, 2.0)
            for _ in range(110):
                chunk = planner.step()
    for _ in range(250):
        chunk = planner.step()
    hand = KINEMATICS.forward(chunk.q[-1])[0] + planner.workspace.base_position
    np.testing.assert_allclose(hand, start, atol=5e-5)
    assert np.abs(chunk.q[-1] - START).max() < 0.02


def test_settles_where_the_training_kinematics_do(planner: Planner) -> None:
    """mink's answer and the batched one of the simulation put the hand at the same pose."""
    rng = np.random.default_rng(5)
    base = np.array(planner.workspace.base_position)
    for target in rng.uniform(planner.workspace.low, planner.workspace.high, (3, 3)):
        planner.set_target(target, 1.0)
        for _ in range(130):
            chunk = planner.step()
        trained = KINEMATICS.inverse(
            target - base, frames.HAND_DOWN, START, posture=START, max_iterations=50
        )
        expected, expected_rotation = KINEMATICS.forward(trained.q)
        position, rotation = KINEMATICS.forward(chunk.q[-1])
        assert np.linalg.norm(position - expected) < 1e-4
        tilt = np.linalg.norm(rotation_vector(rotation.T @ expected_rotation))
        assert np.degrees(tilt) < 0.05


@pytest.mark.parametrize(
    "direction", [(0.0, 1.0, 0.0), (0.0, 0.9, 0.4), (0.0, 0.0, 1.0), (0.0, 0.6, -0.5)]
)
def test_follows_150_mm_per_second(planner: Planner, direction: tuple[float, ...]) -> None:
    way = np.array(direction) / np.linalg.norm(direction)
    start = np.array(planner.workspace.start)
    run = follow(planner, [start + 0.015 * (k + 1) * way for k in range(5)])
    along = (run.hand_w - start) @ way
    lateral = np.linalg.norm(run.hand_w - start - along[:, None] * way, axis=1)
    commanded = (run.command_w - start) @ way
    half = commanded.max() / 2
    lag = 0.004 * (np.argmax(along > half) - np.argmax(commanded > half))
    assert lateral.max() < 0.5e-3
    assert 0.04 < lag < 0.09
    assert along.max() - commanded.max() < 2e-3
    assert np.degrees(run.tilt.max()) < 0.2
    assert run.continued == 0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_targets_must_be_numbers(planner: Planner, value: float) -> None:
    good = planner.command_position
    bad = good.copy()
    bad[1] = value
    for target, duration in (
        (bad, 0.1),
        (good[:2], 0.1),
        (good, value),
        (good, 0.0),
        (good, -0.1),
    ):
        with pytest.raises(LimitViolationError):
            planner.set_target(target, duration)
    np.testing.assert_array_equal(planner.command_position, good)


def test_reset_refuses_what_it_cannot_continue(planner: Planner) -> None:
    with pytest.raises(LimitViolationError, match="finite"):
        planner.reset(np.full(7, np.nan))
    with pytest.raises(LimitViolationError, match="finite"):
        planner.reset(START[:6])
    beyond = START.copy()
    beyond[1] = yumi.POSITION_UPPER[1]
    with pytest.raises(LimitViolationError, match="joint index 1"):
        planner.reset(beyond)
    with pytest.raises(KinematicsError, match="outside"):
        planner.reset(np.array(yumi.HOME["right"]))
    tilted = START.copy()
    tilted[6] += 0.3
    with pytest.raises(KinematicsError, match="tilted"):
        planner.reset(tilted)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda w: Planner(w, limits.profile("lab")).step(), "reset"),
        (lambda w: Planner(replace(w, start=(0.0, 0.0, 0.2)), limits.profile("lab")), "start"),
    ],
)
def test_configuration_errors(
    workspace: Workspace, make: Callable[[Workspace], object], message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message):
        make(workspace)


def test_unreachable_box_is_refused(workspace: Workspace) -> None:
    far = replace(workspace, high=(0.8, 0.135, 0.355))
    with pytest.raises(KinematicsError):
        Planner(far, limits.profile("lab"))


def test_negative_splice_is_refused(planner: Planner) -> None:
    with pytest.raises(ConfigurationError, match="negative"):
        planner.step(-1)
