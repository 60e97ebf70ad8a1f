"""The bounds of the hand, on paths that are given, not computed, so as to meet them exactly."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from skewmi.deploy.safety.limits import ChunkChecker, LimitUsage
from skewmi.errors import LimitViolationError
from skewmi.policy_io import Array, Workspace
from skewmi.robot_models import limits

LAB = limits.profile("lab")
MIDDLE = (LAB.position_lower + LAB.position_upper) / 2
BASE = (-0.5, 0.125, 0.25)
LOW, HIGH = np.array([-0.25, -0.5, 0.0]), np.array([0.75, 0.0, 0.25])
"""The box in the robot base frame, m: no two sides alike, none symmetric."""
GRID_DT = 1 / 256
AXES = range(3)
DIRECTIONS = [
    np.array(d) / np.linalg.norm(d) for d in itertools.product((-1, 0, 2), repeat=3) if any(d)
]


def box() -> Workspace:
    return Workspace(
        low=tuple((LOW + BASE).tolist()),
        high=tuple((HIGH + BASE).tolist()),
        start=tuple(BASE),
        base_position=BASE,
        hand_quaternion_wxyz=(1.0, 0.0, 0.0, 0.0),
        free_following_error=1.0,
        held_following_error=0.2,
        stop_blockage=0.45,
        start_configuration=tuple(MIDDLE.tolist()),
        gripper_opening=0.01,
    )


def check(path: Array, workspace: Workspace | None = None, **options: float) -> LimitUsage:
    """Check a resting arm whose hand is said to follow a path in the base frame, (n, 3), m."""
    q = np.tile(MIDDLE, (len(path), 1))
    rotations = np.tile(np.eye(3), (len(path), 1, 1))
    checker = ChunkChecker(
        LAB, workspace, lambda _: (path, rotations), **{"grid_dt": GRID_DT, **options}
    )
    return checker.check(q, 0 * q, 0 * q)


def refusal(
    path: Array, workspace: Workspace | None = None, **options: float
) -> LimitViolationError:
    with pytest.raises(LimitViolationError) as caught:
        check(path, workspace, **options)
    return caught.value


def test_reduced_speed_in_every_direction_and_at_every_step() -> None:
    """250 mm/s of ISO 10218-1."""
    factors = (0.0, 0.1, 0.999, 1.001, 2.0, 100.0)
    for direction, row, factor in itertools.product(DIRECTIONS, (1, 3, 5), factors):
        path = np.zeros((6, 3))
        path[row:] = direction * 0.25 * factor * GRID_DT
        if factor < 1.0:
            usage = check(path)
            assert usage.tcp_speed == pytest.approx(factor, rel=1e-12)
            assert usage.workspace == 0.0
        else:
            error = refusal(path)
            assert (error.limit, error.bound) == ("tool speed, m/s", 0.25)
            assert error.value == pytest.approx(0.25 * factor, rel=1e-12)
            assert type(error.value) is float


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("speed", [0.0625, 0.25, 1.5])
def test_the_speed_limit_itself_is_allowed(axis: int, speed: float) -> None:
    path = np.zeros((2, 3))
    path[1, axis] = speed * GRID_DT
    assert check(path, tcp_speed=speed).tcp_speed == 1.0
    path[1, axis] = np.nextafter(path[1, axis], 1.0)
    assert refusal(path, tcp_speed=speed).bound == speed


def test_every_side_of_the_box_at_every_sample() -> None:
    beyonds = (-0.01, 0.0, 0.004999, 0.005001, 0.01, 1.0, 10.0)
    for axis, side, row, beyond in itertools.product(AXES, (-1.0, 1.0), range(3), beyonds):
        path = np.tile((LOW + HIGH) / 2, (3, 1))
        path[row, axis] = (HIGH if side > 0 else LOW)[axis] + side * beyond
        half = (HIGH - LOW)[axis] / 2
        if beyond < 0.005:
            usage = check(path, box(), tcp_speed=1e4)
            assert usage.workspace == pytest.approx((half + beyond) / half, rel=1e-12)
            assert usage.tcp_speed > 0.0
            assert usage.position > 0.0
            assert {type(value) for value in usage.as_dict().values()} == {float}
        else:
            error = refusal(path, box(), tcp_speed=1e4)
            assert (error.limit, error.bound) == ("distance outside the workspace, m", 0.005)
            assert error.value == pytest.approx(beyond, rel=1e-9)
            assert type(error.value) is float
            assert str(error).endswith(f"(axis {'xyz'[axis]})")


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("tolerance", [0.0, 0.125])
def test_the_tolerance_itself_is_allowed(axis: int, tolerance: float) -> None:
    for side in (LOW - tolerance, HIGH + tolerance):
        path = np.tile((LOW + HIGH) / 2, (2, 1))
        path[:, axis] = side[axis]
        check(path, box(), workspace_tolerance=tolerance)
        path[1, axis] += np.copysign(1e-9, side[axis] - (LOW + HIGH)[axis] / 2)
        assert refusal(path, box(), workspace_tolerance=tolerance).bound == tolerance


@pytest.mark.parametrize("worst", AXES)
def test_the_axis_furthest_out_is_named(worst: int) -> None:
    path = np.tile(HIGH + 0.25, (4, 1))
    path[2, worst] += 0.5
    error = refusal(path, box(), tcp_speed=1e4)
    assert error.value == pytest.approx(0.75)
    assert f"axis {'xyz'[worst]}" in str(error)


def test_speed_is_judged_before_the_box() -> None:
    path = np.array([LOW, HIGH + 1.0])
    assert refusal(path, box()).limit == "tool speed, m/s"
