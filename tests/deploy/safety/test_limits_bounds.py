"""Dense sweeps around every bound of the chunk checker: accepted up to it, refused beyond.

The bounds are written out here once more, as numbers: the checker must agree with them.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from limit_chunks import (
    CHECKER,
    HALF,
    JERK,
    JOINTS,
    LAB,
    LADDER,
    MIDDLE,
    SIGNED_JOINTS,
    H,
    refusal,
    still,
    verdict,
)

from skewmi.deploy.safety.limits import ChunkChecker


@pytest.mark.parametrize(("which", "name"), [(1, "velocity"), (2, "acceleration")])
@pytest.mark.parametrize(("row", "where"), [(0, "at the first start"), (-1, "at the end")])
def test_rest_is_a_billionth(which: int, name: str, row: int, where: str) -> None:
    for joint, sign in SIGNED_JOINTS:
        for factor in (*LADDER, 1.0):
            chunk = still(3)
            chunk[which][row, joint] = sign * factor * 1e-9
            assert verdict(CHECKER, *chunk) == (f"{name} {where}" if factor > 1.0 else "")


def test_the_joint_with_the_largest_excess_is_named() -> None:
    for joint in JOINTS:
        q, v, a = still(2)
        v[-1] = 2e-9
        v[-1, joint] = -3e-9
        error = refusal(CHECKER, q, v, a)
        assert (error.value, error.bound) == (3e-9, 1e-9)
        assert f"joint index {joint}" in str(error)


@pytest.mark.parametrize(
    ("which", "name", "tolerance"),
    [(0, "position", 1e-9), (1, "velocity", 1e-7), (2, "acceleration", 1e-5)],
)
def test_splice_tolerances(which: int, name: str, tolerance: float) -> None:
    for joint, sign in SIGNED_JOINTS:
        chunk = still(4)
        for factor in LADDER:
            here = [part[0].copy() for part in chunk]
            here[which][joint] += sign * factor * tolerance
            expected = f"{name} jump at the splice" if factor > 1.0 else ""
            assert verdict(CHECKER, *chunk, previous=tuple(here)) == expected
        error = refusal(CHECKER, *chunk, previous=tuple(here))
        assert error.value == pytest.approx(1e3 * tolerance, rel=1e-6)
        assert error.bound == tolerance


@pytest.mark.parametrize("which", [0, 1, 2])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_the_motion_in_progress_must_be_finite(which: int, value: float) -> None:
    for joint in JOINTS:
        chunk = still(4)
        point = [part[0].copy() for part in chunk]
        point[which][joint] = value
        error = refusal(CHECKER, *chunk, previous=tuple(point))
        assert error.limit == "finite numbers"
        assert math.isnan(error.value)
        assert error.bound == 0.0
        assert "previous motion" in str(error)


def thresholds(joint: int, shape: str) -> list[tuple[float, str]]:
    """From which size on a pulse or a step of one number breaks what, the largest first.

    In the middle of a chunk at rest, with u = (0, 0, 0, 1, 0, 0, 0) for a pulse and the running
    sum of it for a step. The largest differences of a pulse are 1, 2, 3 (of order one, two,
    three), of a step 1, 1, 2, each over h to its order.
    """
    velocity, acceleration = float(LAB.velocity[joint]), 15.0
    return {
        "q step": [
            (velocity * H, "joint velocity"),
            (acceleration * H**2, "joint acceleration"),
            (JERK * H**3 / 2, "joint jerk"),
            (JERK * H**3 / 6, "position against velocity"),
        ],
        "q pulse": [
            (velocity * H, "joint velocity"),
            (acceleration * H**2 / 2, "joint acceleration"),
            (JERK * H**3 / 3, "joint jerk"),
            (JERK * H**3 / 6, "position against velocity"),
        ],
        "v pulse": [
            (velocity, "joint velocity"),
            (acceleration * H, "joint acceleration"),
            (JERK * H**2 / 2, "joint jerk"),
            (JERK * H**2 / 6, "position against velocity"),
        ],
        "a pulse": [
            (acceleration, "joint acceleration"),
            (JERK * H, "joint jerk"),
            (JERK * H / 2, "velocity against acceleration"),
            (JERK * H / 3, "position against velocity"),
        ],
    }[shape]


@pytest.mark.parametrize("shape", ["q step", "q pulse", "v pulse", "a pulse"])
def test_a_false_number_breaks_the_first_limit_that_it_exceeds(shape: str) -> None:
    for joint, sign in SIGNED_JOINTS:
        table = thresholds(joint, shape)
        sizes = sorted(bound * factor for bound, _ in table for factor in (0.99999, 1.00001, 1.05))
        for size in (0.0, *sizes, 10.0):
            chunk = still(7)
            values = chunk["qva".index(shape[0])]
            rows = slice(3, None) if shape.endswith("step") else 3
            values[rows, joint] += sign * size
            # A position far out is a broken position limit before all others.
            beyond = shape[0] == "q" and size > HALF[joint] - 15.0 * H**2 / 8
            expected = next((limit for bound, limit in table if size > bound), "")
            assert verdict(CHECKER, *chunk) == ("joint position" if beyond else expected), size


def test_the_joint_named_is_the_furthest_over_its_own_bound() -> None:
    """Not the fastest, nor the one with the most rad/s in excess."""
    v = np.zeros((7, 7))
    v[3, 0], v[3, 6] = 1.3 * LAB.velocity[0], -1.2 * LAB.velocity[6]
    assert 0.3 * LAB.velocity[0] < 0.2 * LAB.velocity[6]
    error = refusal(CHECKER, still(7)[0], v, 0 * v)
    assert (error.limit, error.value, error.bound) == (
        "joint velocity",
        v[3, 0],
        LAB.velocity[0],
    )
    assert str(error).endswith("(joint index 0)")
    assert type(error.value) is type(error.bound) is float


@pytest.mark.parametrize(("excess", "limit"), [(0.9e-6, "joint jerk"), (1.1e-6, "joint acceler")])
def test_a_millionth_over_a_bound_is_rounding(excess: float, limit: str) -> None:
    q, v, a = still(7)
    a[3, 2] = 15.0 * (1.0 + excess)
    assert verdict(CHECKER, q, v, a).startswith(limit)


@pytest.mark.parametrize("jerk", [1e-8, 1e-6])
def test_consistency_leaves_a_picoradian_of_room(jerk: float) -> None:
    """So that the rounding of positions cannot break the bounds of a very small jerk."""
    checker = ChunkChecker(replace(LAB, jerk=np.full(7, jerk)))
    for joint in range(7):
        for factor in (0.9, 1.1):
            q, v, a = still(2, np.zeros(7) + 0.2 * HALF + MIDDLE)
            q[1, joint] += factor * (jerk * H**3 / 6 + 1e-12)
            assert verdict(checker, q, v, a) == ("position against velocity" * (factor > 1.0))
            for sign in (1.0, -1.0):
                q, v, a = still(2)
                v[0, joint] = sign * factor * (jerk * H**2 / 2 + 1e-12)
                previous = q[0], v[0], a[0]
                expected = "velocity against acceleration" * (factor > 1.0)
                assert verdict(checker, q, v, a, previous=previous) == expected


def test_position_bounds_leave_room_between_the_samples() -> None:
    for joint, sign in SIGNED_JOINTS:
        room = 15.0 * H**2 / 8
        for beyond in np.array(
            [-1.0, -1e-3, -1.1 * room, -1.01 * room, -0.99 * room, 0.0, 1e-3, 1.0]
        ):
            q, v, a = still(2)
            q[:, joint] += sign * (HALF[joint] + beyond)
            if beyond < -room:
                usage = CHECKER.check(q, v, a)
                reached = (HALF[joint] + beyond + room) / HALF[joint]
                assert usage.position == pytest.approx(max(reached, (room / HALF).max()), rel=1e-12)
            else:
                error = refusal(CHECKER, q, v, a)
                assert (error.limit, error.value) == ("joint position", q[0, joint])
                assert (
                    error.bound == (LAB.position_upper if sign > 0 else LAB.position_lower)[joint]
                )
                assert str(error).endswith(f"(joint index {joint})")


def test_the_joint_and_sample_furthest_out_are_named() -> None:
    for joint, sign in SIGNED_JOINTS:
        q, v, a = still(9, MIDDLE - sign * (HALF + 0.01))
        q[5:7, joint] = MIDDLE[joint] + sign * (HALF[joint] + np.array([0.03, 0.02]))
        error = refusal(CHECKER, q, v, a)
        assert error.value == q[5, joint]
        assert error.bound == (LAB.position_upper if sign > 0 else LAB.position_lower)[joint]
        assert f"joint index {joint}" in str(error)


def test_the_position_bound_itself_is_allowed() -> None:
    """With numbers that a double holds exactly: A h^2 / 8 is 2^-15."""
    bounds = replace(
        LAB,
        position_lower=np.full(7, -1.0),
        position_upper=np.full(7, 1.0),
        acceleration=np.full(7, 16.0),
    )
    checker = ChunkChecker(bounds, grid_dt=2.0**-8)
    for joint, sign in SIGNED_JOINTS:
        q, v, a = still(2, np.zeros(7))
        q[:, joint] = sign * (1.0 - 2.0**-15)
        assert checker.check(q, v, a).position == 1.0
        q[1, joint] += sign * 2.0**-40
        error = refusal(checker, q, v, a)
        assert error.bound == sign
        assert type(error.value) is type(error.bound) is float
