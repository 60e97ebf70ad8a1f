"""The judge of the cells sees what it must: motion that breaks one limit each."""

from __future__ import annotations

import numpy as np
import pytest
from fault_chunks import breach, motion
from fault_motion import ACCELERATION, JERK, VELOCITY, Motion, assert_safe, shares
from fault_robot import RESET, STEP, TAKEN

from skewmi.policy_io import Array
from skewmi.sim.tasks.open_press_close.definition import make_layout

WORKSPACE = make_layout().workspace
assert WORKSPACE is not None
START = np.array(WORKSPACE.start_configuration)
REST = (START, np.zeros(7), np.zeros(7))


def logged(q: Array) -> Motion:
    """As if the robot server had commanded these positions, and the arm had followed."""
    times = 0.004 * np.arange(len(q))
    rows = np.column_stack([np.full(len(q), STEP), times, q, q])
    return Motion.of(rows, q[-1])


def small_motion() -> Array:
    goal = START + np.array([0.02, -0.01, 0.0, 0.01, 0.0, 0.02, 0.0])
    return motion(REST, goal, 0.3 * VELOCITY, ACCELERATION, JERK)[0]


def test_motion_within_all_limits_is_accepted() -> None:
    used = assert_safe(logged(small_motion()))
    assert 0.9 < used["jerk"] <= 1.0 + 1e-6


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("position", "position"),
        ("velocity", "velocity"),
        ("acceleration", "acceleration"),
        ("jerk", "jerk"),
        ("tool speed", "tool"),
        ("workspace box", "box"),
    ],
)
def test_each_breach_is_seen(kind: str, name: str) -> None:
    broken = logged(breach(kind, REST)[0])
    assert shares(broken)[name] > 1.0 + 1e-4
    with pytest.raises(AssertionError, match="of its limit"):
        assert_safe(broken)


@pytest.mark.parametrize("rows", range(3, 22, 3))
def test_motion_that_ends_abruptly_is_seen(rows: int) -> None:
    with pytest.raises(AssertionError, match="of its limit"):
        assert_safe(logged(small_motion()[:rows]))


def interrupted(kind: float, stop: int, q: Array) -> Motion:
    """A motion of which nothing more was commanded after some rows, and a rest somewhere else."""
    rows = np.column_stack([np.full(stop, STEP), 0.004 * np.arange(stop), q[:stop], q[:stop]])
    after = np.concatenate([[kind, 0.004 * stop], START, START])
    return Motion.of(np.concatenate([rows, after[None]]), START)


def test_arm_that_was_taken_away_in_motion_is_judged_up_to_then() -> None:
    q = small_motion()
    assert_safe(interrupted(TAKEN, len(q) // 2, q))
    with pytest.raises(AssertionError, match="of its limit"):
        assert_safe(interrupted(RESET, len(q) // 2, q))
    broken = breach("jerk", REST)[0]
    with pytest.raises(AssertionError, match="of its limit"):
        assert_safe(interrupted(TAKEN, len(broken), broken))


def test_arm_that_is_elsewhere_is_seen() -> None:
    q = small_motion()
    rows = np.column_stack([np.full(len(q), STEP), 0.004 * np.arange(len(q)), q, q + 0.1])
    with pytest.raises(AssertionError, match="elsewhere"):
        assert_safe(Motion.of(rows, q[-1]))


def test_standing_still_on_the_way_is_counted() -> None:
    there = small_motion()
    back = motion((there[-1], *REST[1:]), START, 0.3 * VELOCITY, ACCELERATION, JERK)[0]
    pause = np.repeat(there[-1:], 10, axis=0)
    assert logged(np.concatenate([there, pause, back])).standstills(0.0) == 1
    assert logged(there).standstills(0.0) == 0
