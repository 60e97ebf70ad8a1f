"""Any command, any limits: the planner breaks none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import planner_fuzz
import planner_scenes
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from planned_runs import KINEMATICS, START, follow
from slow_limits import slowed

from skewmi.deploy.motion.cartesian_shaper import CartesianShaper, Reference
from skewmi.deploy.motion.joint_shaper import HARD_MARGIN
from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.safety.limits import ChunkChecker
from skewmi.policy_io import Workspace
from skewmi.robot_models import limits


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
    slow = Planner(workspace, slowed(limits.profile("lab"), 0.1))
    slow.reset(START)
    goal = np.array(workspace.start) + np.array([0.0, 0.1, 0.0])
    run = follow(slow, [goal], settle_cycles=300)
    velocity = np.abs(np.diff(run.q, axis=0)).max(axis=0) / 0.004
    assert (velocity <= slow.limits.velocity).all()
    np.testing.assert_allclose(run.hand_w[-1], goal, atol=5e-4)


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


@settings(max_examples=60, deadline=None)
@example(joints={2, 3, 4, 6}, seed=272, profile="lab")
@given(
    joints=st.sets(st.integers(0, 6), min_size=1, max_size=4),
    seed=st.integers(0, 2**32 - 1),
    profile=st.sampled_from(["lab", "careful"]),
)
def test_from_rest_beside_any_bounds_nothing_is_held_back_for_long(
    joints: set[int], seed: int, profile: str
) -> None:
    """Joints rest up to 6 mrad from where they may be, some within a microradian of it."""
    rng = np.random.default_rng(seed)
    bounds = limits.profile(profile)
    lower, upper = bounds.position_lower.copy(), bounds.position_upper.copy()
    for joint in joints:
        room = HARD_MARGIN + 10.0 ** rng.uniform(-6.0, -2.2)
        if rng.random() < 0.5:
            lower[joint] = START[joint] - room
        else:
            upper[joint] = START[joint] + room
    planner = Planner(
        planner_scenes.press_workspace(START),
        replace(bounds, position_lower=lower, position_upper=upper),
    )
    planner.reset(START)
    planner.set_target(rng.uniform(planner.workspace.low, planner.workspace.high), 0.5)
    in_a_row = longest = 0
    for _ in range(60):
        planner.step()
        in_a_row = 0 if planner.held_back is None else in_a_row + 1
        longest = max(longest, in_a_row)
    assert longest <= 12
