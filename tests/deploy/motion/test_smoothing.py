"""The smoothed command: a mean of where the command has been, and what is left of its corners."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.motion.cartesian_shaper import Reference
from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.motion.smoothing import DELAY_S, WINDOW_S, SmoothedReference
from skewmi.smoothness import LIMITS, power_above
from skewmi.trajectory import GRID_S

WINDOW = round(WINDOW_S / GRID_S)


def walk(seed: int, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A command to random targets: what it was, its smoothed position and velocity, per step."""
    random = np.random.default_rng(seed)
    reference = Reference(random.uniform(-0.1, 0.1, 3))
    smoothed = SmoothedReference(reference.position_w)
    rows = [(reference.position_w.copy(), smoothed.position_w, smoothed.velocity_w)]
    for step in range(steps):
        if step % 25 == 0:
            target = reference.position_w + random.uniform(-0.015, 0.015, 3)
            reference.set_target(target, random.uniform(0.02, 0.2))
        reference.advance(GRID_S)
        smoothed.follow(reference)
        rows.append((reference.position_w.copy(), smoothed.position_w, smoothed.velocity_w))
    r, s, v = np.array(rows).transpose(1, 0, 2)
    return r, s, v


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_it_is_the_mean_over_the_window_weighted_by_a_hann_window(seed: int) -> None:
    r, s, _ = walk(seed, 200)
    weights = np.sin(np.pi * np.arange(1, WINDOW + 1) / (WINDOW + 1)) ** 2
    for axis in range(3):
        expected = np.convolve(r[:, axis], weights / weights.sum(), mode="valid")
        np.testing.assert_allclose(s[WINDOW - 1 :, axis], expected, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_it_never_leaves_the_box_of_the_command(seed: int) -> None:
    r, s, _ = walk(seed, 200)
    assert (s <= r.max(axis=0) + 1e-12).all()
    assert (s >= r.min(axis=0) - 1e-12).all()


def test_a_straight_line_stays_one_behind_the_command_by_the_delay() -> None:
    reference = Reference(np.zeros(3))
    smoothed = SmoothedReference(np.zeros(3))
    reference.set_target(np.array([0.3, 0.0, 0.0]), 2.0)
    for _ in range(100):
        reference.advance(GRID_S)
        smoothed.follow(reference)
    np.testing.assert_allclose(smoothed.velocity_w, [0.15, 0.0, 0.0], atol=1e-12)
    behind = reference.position_w[0] - smoothed.position_w[0]
    # The newest sample is one grid step after the one before it: half a step less.
    assert behind == pytest.approx(0.15 * (DELAY_S - GRID_S / 2), abs=1e-9)


def test_it_rests_after_the_window() -> None:
    reference = Reference(np.zeros(3))
    smoothed = SmoothedReference(np.zeros(3))
    reference.set_target(np.array([0.01, -0.01, 0.0]), 5 * GRID_S)
    for _ in range(6 + WINDOW):
        reference.advance(GRID_S)
        smoothed.follow(reference)
    np.testing.assert_allclose(smoothed.position_w, reference.target_w, atol=1e-15)
    np.testing.assert_array_equal(smoothed.velocity_w, np.zeros(3))


@pytest.mark.parametrize("seed", range(3))
def test_a_wild_policy_does_not_shake_the_joints(planner: Planner, seed: int) -> None:
    random = np.random.default_rng(seed)
    target = planner.command_position
    accelerations = []
    for step in range(60):
        action = random.uniform(-1.0, 1.0, 3) if step < 55 else np.zeros(3)
        target = np.clip(target + 0.015 * action, planner.workspace.low, planner.workspace.high)
        planner.set_target(target, 0.1)
        accelerations += [planner.step().a[1:6] for _ in range(5)]
    a = np.concatenate(accelerations)
    for frequency, limit in LIMITS.items():
        # Twice what counts as smooth: no policy is as wild.
        assert power_above(a, GRID_S, frequency).max() < 2.0 * limit
