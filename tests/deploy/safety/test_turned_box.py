"""What judges motion before a displaced box accepts what it accepts before one in its place.

The truth is worked out apart: MuJoCo with a robot that really stands elsewhere says where the hand
is in the box's frame, and plain comparisons with the box's own numbers say whether it may be there.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from moved_boxes import ORIGIN, Displacement, base_in_box, drawn, hand_by_mujoco

from skewmi.box_frame import placed
from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.safety.checks import ChunkChecks, limit_check
from skewmi.deploy.safety.flange_space import CALIBRATION, FlangeSpace, SpaceCheck, flange_spaces
from skewmi.deploy.safety.guard import TILT, Guard
from skewmi.deploy.safety.limits import ChunkChecker
from skewmi.deploy.safety.obstacles import scene_obstacles
from skewmi.deploy.wire.scene_geometry import ScenePart
from skewmi.errors import ConfigurationError, LimitViolationError
from skewmi.policy_io import Array, Workspace
from skewmi.robot_models import limits
from skewmi.robot_models.base_frame import BoxPose
from skewmi.robot_models.frames import HAND_DOWN, rotation_from_quaternion
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.obstacle import Obstacle
from skewmi.sim.tasks.open_press_close.definition import make_layout
from skewmi.trajectory import JointPoint, JointTrajectory

LAB = limits.profile("lab")
SLOW = replace(LAB, velocity=0.3 * LAB.velocity)
ARM = ArmKinematics("right")
CHECKER_ROOM, GUARD_ROOM = 0.005, 0.006
"""How far outside the box the two tolerate the hand, m: restated."""
DISPLACEMENTS = [drawn(np.random.default_rng(seed)) for seed in range(4)] + [(0.05, -0.05, 20.0)]


def nominal() -> Workspace:
    found = make_layout().workspace
    assert found is not None
    return found


def before(displacement: Displacement) -> Workspace:
    return placed(nominal(), BoxPose(*displacement, *ORIGIN))


def at(
    hand_in_box: Array, displacement: Displacement, near: Array, turn: Array = HAND_DOWN
) -> Array:
    """Joints that put the hand somewhere in the box's frame, by transforms written here."""
    to_base = np.linalg.inv(base_in_box(displacement))
    position = (to_base @ np.append(hand_in_box, 1.0))[:3]
    found = ARM.inverse(position, to_base[:3, :3] @ turn, near, max_iterations=100)
    q: Array = found.q
    return q


def outside(q: Array, displacement: Displacement) -> float:
    """By MuJoCo, m; negative inside."""
    hand, _ = hand_by_mujoco(q, displacement)
    low, high = np.array(nominal().low), np.array(nominal().high)
    return float(np.maximum(low - hand, hand - high).max())


def still(q: Array) -> tuple[Array, Array, Array]:
    rows = np.tile(q, (6, 1))
    return rows, np.zeros_like(rows), np.zeros_like(rows)


def accepts(check: object, *arguments: object) -> bool:
    try:
        check(*arguments)  # type: ignore[operator]
    except LimitViolationError as error:
        if "workspace" not in error.limit:
            raise
        return False
    return True


def hands_near_the_faces(rng: np.random.Generator, n: int) -> Array:
    """On both sides of what is tolerated, of every face, edge and corner."""
    low, high = np.array(nominal().low), np.array(nominal().high)
    beyond = rng.choice([-0.004, 0.004, 0.0049, 0.0051, 0.0059, 0.0061, 0.009, 0.03], (n, 3))
    return np.where(rng.random((n, 3)) < 0.5, low - beyond, high + beyond)


@pytest.mark.parametrize("displacement", DISPLACEMENTS)
def test_checker_and_guard_keep_the_hand_in_the_box_that_is_displaced(
    displacement: Displacement,
) -> None:
    rng = np.random.default_rng(11)
    workspace = before(displacement)
    start = np.array(workspace.start_configuration)
    checker, guard = ChunkChecker(LAB, workspace, ARM.forward), Guard(LAB, workspace)
    seen = set()
    for hand in hands_near_the_faces(rng, 40):
        q = at(hand, displacement, start)
        beyond = outside(q, displacement)
        seen.add((beyond <= CHECKER_ROOM, beyond <= GUARD_ROOM))
        assert accepts(checker.check, *still(q)) == (beyond <= CHECKER_ROOM), hand
        assert accepts(guard.check, *still(q)) == (beyond <= GUARD_ROOM), hand
    assert len(seen) == 3, "inside, outside of both, and between the two must all have been tried"


def leaves(inside: np.ndarray, outside: np.ndarray) -> bool:
    """Whether something is outside after it was inside."""
    return bool((np.logical_or.accumulate(inside) & outside).any())


@pytest.mark.parametrize("displacement", DISPLACEMENTS)
def test_the_same_motions_pass_before_both_boxes(displacement: Displacement) -> None:
    """Hand motions are the same in the box's frame; the joints that make them are not."""
    rng = np.random.default_rng(12)
    sides = {(0.0, 0.0, 0.0): nominal(), displacement: before(displacement)}
    judges = {
        where: (limit_check(LAB, workspace), Guard(LAB, workspace))
        for where, workspace in sides.items()
    }
    outcomes = []
    for first, second in zip(
        hands_near_the_faces(rng, 12), hands_near_the_faces(rng, 12), strict=True
    ):
        found = []
        for where, workspace in sides.items():
            start = np.array(workspace.start_configuration)
            q = [at(hand, where, start) for hand in (first, second)]
            motion = StartMotion(q[0], q[1], SLOW).trajectory
            check, guard = judges[where]
            present = JointPoint(q[0], np.zeros(7), np.zeros(7))
            part = JointTrajectory(motion.q, motion.v, motion.a)
            ok = accepts(check, part, present, np.tile(q[0], (3, 1)))
            # It may come from anywhere, and must stay once it is inside.
            rows = motion.q[:: max(1, len(motion.q) // 100) if ok else 1]
            beyond = np.array([outside(row, where) for row in rows]) - CHECKER_ROOM
            if leaves(beyond < -1e-4, beyond > 1e-4):
                assert not ok
            elif not leaves(beyond < 1e-4, beyond > -1e-4):
                assert ok
            # Before another box the joints, and so the hand between two places, go another way.
            same = ok if beyond[0] <= 1e-6 else None
            found.append(
                (same, accepts(guard.check, *still(q[0])), accepts(guard.check, *still(q[1])))
            )
        assert found[0] == found[1]
        outcomes.append(found[0])
    assert len(set(outcomes)) > 2


@pytest.mark.parametrize("displacement", DISPLACEMENTS)
def test_the_guard_wants_the_hand_turned_with_the_box(displacement: Displacement) -> None:
    workspace = before(displacement)
    start = np.array(workspace.start_configuration)
    guard = Guard(LAB, workspace)
    middle = (np.array(workspace.low) + np.array(workspace.high)) / 2.0
    for axis, angle in itertools.product(np.eye(3), (-0.99, 0.99, -1.01, 1.01)):
        half = angle * TILT / 2.0
        turn = rotation_from_quaternion((np.cos(half), *(np.sin(half) * axis)))
        q = at(middle, displacement, start, turn @ HAND_DOWN)
        if abs(angle) < 1.0:
            assert guard.check(*still(q)).tilt == pytest.approx(abs(angle) * TILT, abs=1e-5)
        else:
            with pytest.raises(LimitViolationError, match="tilt"):
                guard.check(*still(q))


def test_a_turn_that_is_not_known_is_a_breach() -> None:
    """Guard and checker do not just follow whatever they are told: an unturned hand is tilted."""
    displacement = (0.0, 0.0, 8.0)
    q = np.array(nominal().start_configuration)
    guard = Guard(LAB, before(displacement))
    with pytest.raises(LimitViolationError, match=r"tilt|workspace"):
        guard.check(*still(q))


@pytest.mark.parametrize("displacement", DISPLACEMENTS)
def test_a_space_whose_axes_are_turned_is_the_box(displacement: Displacement) -> None:
    """As `skewmi home` and `jog` see the task's box."""
    workspace = before(displacement)
    base = base_in_box(displacement)
    low, high = (
        tuple((np.array(c) - base[:3, 3]).tolist()) for c in (workspace.low, workspace.high)
    )
    yaw = -float(np.arctan2(base[1, 0], base[0, 0]))
    space = FlangeSpace("task", low, high, yaw=yaw)
    assert FlangeSpace.from_numbers("task", space.numbers()) == space
    check = SpaceCheck(LAB, space, ARM.forward)
    rng = np.random.default_rng(13)
    middle = (np.array(workspace.low) + np.array(workspace.high)) / 2.0
    start = at(middle, displacement, np.array(workspace.start_configuration))
    seen = set()
    for hand in hands_near_the_faces(rng, 30):
        way = np.array([start, at(hand, displacement, start)])
        inside = outside(way[1], displacement) <= CHECKER_ROOM
        seen.add(inside)
        assert accepts(check.check_way, way) == inside
    assert seen == {True, False}


def test_obstacles_hold_every_corner_of_what_stands_there() -> None:
    rng = np.random.default_rng(14)
    for displacement in DISPLACEMENTS:
        box = BoxPose(*displacement, *ORIGIN)
        parts = [
            ScenePart(
                f"part {k}",
                "",
                tuple(rng.uniform(0.01, 0.1, 3)),
                tuple(rng.uniform((-0.1, -0.2, 0.05), (0.1, 0.1, 0.2))),
                tuple(q / np.linalg.norm(q)),
                (0.0,) * 4,
            )
            for k, q in enumerate(rng.normal(size=(5, 4)))
        ]
        obstacles = scene_obstacles(parts, base=box.base_frame())
        to_base = np.linalg.inv(base_in_box(displacement))
        for part in parts:
            turn = rotation_from_quaternion(part.quaternion_wxyz)
            for sign in itertools.product((-1.0, 1.0), repeat=3):
                corner = np.array(part.position) + turn @ (np.array(sign) * part.half_size)
                point = (to_base @ np.append(corner, 1.0))[:3]
                assert any(_holds(obstacle, point) for obstacle in obstacles)
        # And no more than there is: each touches a part with every side, as before the nominal one.
        sizes = sorted(obstacle.half_size for obstacle in obstacles)
        np.testing.assert_allclose(
            sizes, sorted(obstacle.half_size for obstacle in scene_obstacles(parts)), atol=1e-12
        )


def _holds(obstacle: Obstacle, point: Array) -> bool:
    away = np.abs(base_rotation(-obstacle.yaw) @ (point - np.array(obstacle.centre)))
    return bool((away <= np.array(obstacle.half_size) + 1e-9).all())


def test_spaces_are_given_as_long_as_they_hold_the_whole_displaced_box() -> None:
    top = Obstacle((0.4, -0.07, 0.06), (0.1, 0.1, 0.06), name="scene")
    for displacement in DISPLACEMENTS:
        assert CALIBRATION in flange_spaces(before(displacement), [top])
    # Its corner is beyond y = 0.20 m of the clear space only if it is turned.
    wide = replace(nominal(), high=(0.05, 0.19, 0.355))
    assert CALIBRATION in flange_spaces(wide, [top])
    turned = replace(wide, base_yaw=-0.15)
    corner = base_rotation(0.15) @ (np.array(wide.high) - np.array(wide.base_position))
    assert corner[1] > 0.20
    assert CALIBRATION not in flange_spaces(turned, [top])


def base_rotation(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def test_session_and_robot_server_judge_alike_before_a_displaced_box() -> None:
    displacement = (0.02, -0.012, 8.0)
    workspace = before(displacement)
    checks = ChunkChecks(LAB, workspace)
    checks.boxed = True
    server = limit_check(LAB, workspace)
    start = np.array(workspace.start_configuration)
    present, earlier = JointPoint(start, np.zeros(7), np.zeros(7)), np.tile(start, (3, 1))
    low, high = np.array(workspace.low), np.array(workspace.high)
    middle = (low + high) / 2.0
    seen = set()
    for corner in itertools.product(*zip(low, high, strict=True)):
        for share in (0.3, 0.6, 1.0, 1.5):
            q = at(middle + share * (np.array(corner) - middle), displacement, start)
            motion = StartMotion(start, q, SLOW).trajectory
            worst = max(outside(row, displacement) for row in motion.q)
            good = worst <= CHECKER_ROOM
            seen.add(good)
            check = dict(checks.stages)["check"]
            assert accepts(check, motion, present, earlier) == good
            assert accepts(server, motion, present, earlier) == good
    assert seen == {True, False}


def test_a_space_that_is_turned_by_no_number_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="corners"):
        FlangeSpace("task", (0.0,) * 3, (1.0,) * 3, yaw=float("nan"))
