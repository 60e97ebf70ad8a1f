"""The planner: exact splices, stops that always exist, paths that follow the command."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import planner_fuzz
import planner_scenes
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.motion.cartesian_shaper import CartesianShaper, Reference
from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.safety.limits import ChunkChecker
from skewmi.errors import ConfigurationError, KinematicsError, LimitViolationError
from skewmi.policy_io import Array, Workspace
from skewmi.robot_models import frames, limits, yumi
from skewmi.robot_models.frames import rotation_vector
from skewmi.robot_models.kinematics import ArmKinematics

START = np.array(yumi.TABLE_CONFIGURATION)
KINEMATICS = ArmKinematics("right")


@pytest.fixture(scope="module")
def workspace() -> Workspace:
    box: Workspace = planner_scenes.press_workspace(START)
    return box


@pytest.fixture
def planner(workspace: Workspace) -> Planner:
    made = Planner(workspace, limits.profile("lab"))
    made.reset(START)
    return made


@dataclass
class Run:
    """What was executed and commanded, on the grid, from the start on."""

    q: Array
    a: Array
    hand_w: Array
    tilt: Array
    command_w: Array
    continued: int


def follow(
    planner: Planner, targets: list[Array], *, duration_s: float = 0.1, settle_cycles: int = 50
) -> Run:
    """Give one target per `duration_s`, then none, executing every cycle in time."""
    cycles = round(duration_s / 0.02)
    q, a, command, continued = [], [], [], 0
    for cycle in range(len(targets) * cycles + settle_cycles):
        if cycle % cycles == 0 and cycle // cycles < len(targets):
            planner.set_target(targets[cycle // cycles], duration_s)
        begin = planner.command_position
        chunk = planner.step()
        share = np.arange(5)[:, None] / 5
        command.append(begin + share * (planner.command_position - begin))
        q.append(chunk.q[:5])
        a.append(chunk.a[:5])
        continued += planner.held_back is not None
    position, rotation = KINEMATICS.forward(np.vstack(q))
    tilt = rotation_vector(np.swapaxes(rotation, -1, -2) @ frames.HAND_DOWN)
    return Run(
        np.vstack(q),
        np.vstack(a),
        position + np.array(planner.workspace.base_position),
        np.linalg.norm(tilt, axis=1),
        np.vstack(command),
        continued,
    )


# Any command, any limits: nothing is ever broken. The full version is
# tests/adversarial/planner_fuzz.py.


@pytest.mark.parametrize("first_seed", [1000, 2000, 3000])
def test_adversaries_find_no_breach(first_seed: int) -> None:
    totals = planner_fuzz.fuzz(cycles=600, seed=first_seed, seconds=12.0)
    assert totals.breaches == []
    assert totals.rounds >= 1
    for usage in totals.usage.values():
        assert max(usage.values()) <= 1.0
        assert usage["executed jerk"] > 0.5, "the adversaries must push"


@settings(max_examples=8, deadline=None, derandomize=True)
@given(actions=st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 3), min_size=1, max_size=12))
def test_any_policy_keeps_the_limits(actions: list[tuple[float, float, float]]) -> None:
    box = planner_scenes.press_workspace(START)
    planner = Planner(box, limits.profile("lab"))
    planner.reset(START)
    checker = ChunkChecker(planner.limits, box, KINEMATICS.forward)
    position = np.array(box.start)
    state = START, np.zeros(7), np.zeros(7)
    for action in actions:
        position = np.clip(position + 0.015 * np.array(action), box.low, box.high)
        planner.set_target(position, 0.1)
        for _ in range(5):
            chunk = planner.step()
            checker.check(chunk.q, chunk.v, chunk.a, state)
            state = chunk.point(5)


# Splices and stops.


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


# Path quality.


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
    assert 0.02 < lag < 0.07
    assert along.max() - commanded.max() < 1.5e-3
    assert np.degrees(run.tilt.max()) < 0.2
    assert run.continued == 0


@pytest.mark.parametrize(
    ("profile", "axis"),
    [
        ("lab", 0),
        ("lab", 1),
        ("lab", 2),
        ("careful", 0),
        pytest.param("careful", 1, marks=pytest.mark.slow),
        pytest.param("careful", 2, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("side", ["low", "high"])
def test_stops_at_every_face(workspace: Workspace, profile: str, axis: int, side: str) -> None:
    """Driven at a face, the hand stops on it, keeps to it, and comes back when asked."""
    planner = Planner(workspace, limits.profile(profile))
    planner.reset(START)
    target = np.array(workspace.start)
    target[axis] = (workspace.low if side == "low" else workspace.high)[axis]
    beyond = target.copy()
    beyond[axis] += -1.0 if side == "low" else 1.0
    patience = 150 if profile == "lab" else (120 if axis == 0 else 360)
    run = follow(planner, [beyond], settle_cycles=patience)
    outside = np.maximum(np.array(workspace.low) - run.hand_w, run.hand_w - workspace.high)
    assert outside.max() < 1.5e-3
    np.testing.assert_allclose(run.hand_w[-1], target, atol=3e-4)
    back = follow(planner, [np.array(workspace.start)], settle_cycles=patience)
    np.testing.assert_allclose(back.hand_w[-1], workspace.start, atol=3e-4)


@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_stops_at_joint_bounds_and_comes_back(
    workspace: Workspace, joint: int, side: float
) -> None:
    """With bounds close to the start on one side of one joint, every way into them is safe."""
    lab = limits.profile("lab")
    lower, upper = lab.position_lower.copy(), lab.position_upper.copy()
    if side < 0.0:
        lower[joint] = START[joint] - 0.02
    else:
        upper[joint] = START[joint] + 0.02
    tight = replace(lab, position_lower=lower, position_upper=upper)
    planner = Planner(workspace, tight)
    planner.reset(START)
    targets = [np.array(workspace.low), np.array(workspace.high), np.array(workspace.start)]
    run = follow(planner, targets, duration_s=0.6, settle_cycles=100)
    assert (run.q >= lower).all()
    assert (run.q <= upper).all()
    np.testing.assert_allclose(run.hand_w[-1], workspace.start, atol=5e-4)


def test_speed_scale_slows_the_joints(workspace: Workspace) -> None:
    slow = Planner(workspace, limits.profile("lab").scaled(0.1))
    slow.reset(START)
    goal = np.array(workspace.start) + np.array([0.0, 0.1, 0.0])
    run = follow(slow, [goal], settle_cycles=300)
    velocity = np.abs(np.diff(run.q, axis=0)).max(axis=0) / 0.004
    assert (velocity <= slow.limits.velocity).all()
    np.testing.assert_allclose(run.hand_w[-1], goal, atol=5e-4)


# The Cartesian shaper alone.


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_shaped_command_never_leaves_the_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    half = 10 ** rng.uniform(-3, -0.5, 3)
    acceleration, jerk = 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(0, 3)
    shaper = CartesianShaper(-half, half, speed=0.5, acceleration=acceleration, jerk=jerk)
    reference = Reference(shaper.position_w)
    before = shaper.velocity_w, shaper.acceleration_w
    for k in range(150):
        if k % 10 == 0:
            # Targets far beyond the box too: the shaper does not rely on its caller.
            reference.set_target(rng.uniform(-3, 3, 3) * half, float(rng.uniform(0.001, 0.1)))
        reference.advance(0.004)
        shaper.step(reference, shaper.position_w, 1.0)
        assert (np.abs(shaper.position_w) <= half).all()
        v, a = shaper.velocity_w, shaper.acceleration_w
        assert (np.abs(a) <= acceleration * (1 + 1e-9)).all()
        assert (np.abs(a - before[1]) <= jerk * 0.004 * (1 + 1e-6)).all()
        before = v, a


# Bad input.


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
