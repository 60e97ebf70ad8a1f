"""Planning before a displaced box: the hand does in the box's frame what it does before any."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from moved_boxes import ORIGIN, Displacement, base_in_box, hand_by_mujoco
from planned_runs import follow

from skewmi.box_frame import placed
from skewmi.deploy.motion.differential_ik import DifferentialIk
from skewmi.deploy.motion.hand_bounds import derive_hand_bounds
from skewmi.deploy.motion.planner import Planner
from skewmi.policy_io import Array, Workspace
from skewmi.robot_models import limits
from skewmi.robot_models.base_frame import BoxPose
from skewmi.robot_models.frames import HAND_DOWN, rotation_vector
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.sim.tasks.open_press_close.definition import make_layout

LAB = limits.profile("lab")
TOLERANCE = 0.005
DISPLACEMENTS = [(0.02, -0.012, 8.0), (-0.02, 0.02, -10.0), (0.0, 0.0, 20.0)]


def planner_before(displacement: Displacement) -> Planner:
    workspace = make_layout().workspace
    assert workspace is not None
    moved = placed(workspace, BoxPose(*displacement, *ORIGIN))
    planner = Planner(moved, LAB)
    planner.reset(np.array(moved.start_configuration))
    return planner


def hands(q: Array, displacement: Displacement) -> tuple[Array, Array]:
    """By MuJoCo. Positions (n, 3), m, and tilts (n,), rad."""
    poses = [hand_by_mujoco(row, displacement) for row in q]
    turns = np.array([turn for _, turn in poses])
    tilt = np.linalg.norm(rotation_vector(np.swapaxes(turns, 1, 2) @ HAND_DOWN), axis=1)
    return np.array([position for position, _ in poses]), tilt


def steps_in_the_box(workspace: Workspace, seed: int, n: int = 25) -> list[Array]:
    """A walk at full speed, with corners."""
    rng = np.random.default_rng(seed)
    at, walk = np.array(workspace.start), []
    for k in range(n):
        if k % 5 == 0:
            way = rng.choice([-1.0, 1.0], 3) * rng.uniform(0.3, 1.0, 3)
        at = np.clip(at + 0.015 * way, workspace.low, workspace.high)
        walk.append(at)
    return walk


@pytest.mark.parametrize("displacement", DISPLACEMENTS)
def test_the_hand_goes_the_same_way_before_every_box(displacement: Displacement) -> None:
    nominal, moved = planner_before((0.0, 0.0, 0.0)), planner_before(displacement)
    walk = steps_in_the_box(nominal.workspace, 3)
    expected, _ = hands(follow(nominal, walk).q, (0.0, 0.0, 0.0))
    found, tilt = hands(follow(moved, walk).q, displacement)
    # Other bounds of the hand follow from other postures; a velocity along the wrong axes would
    # lead it 4 mm aside at 8 degrees.
    assert np.linalg.norm(found - expected, axis=1).max() < 2.5e-3
    np.testing.assert_allclose(found[-1], expected[-1], atol=1e-4)
    assert tilt.max() < 0.02


@pytest.mark.parametrize("displacement", DISPLACEMENTS)
def test_whatever_is_asked_for_the_hand_stays_in_the_displaced_box(
    displacement: Displacement,
) -> None:
    planner = planner_before(displacement)
    low, high = np.array(planner.workspace.low), np.array(planner.workspace.high)
    rng = np.random.default_rng(4)
    targets = [np.where(rng.random(3) < 0.5, low - 0.1, high + 0.1) for _ in range(8)]
    run = follow(planner, targets, duration_s=1.6)
    position, _ = hands(run.q[::5], displacement)
    assert np.maximum(low - position, position - high).max() <= TOLERANCE
    # And it gets to the faces: they are where the box has them.
    reach = np.minimum(np.abs(position - low), np.abs(position - high)).min(axis=0)
    assert (reach < 1e-3).all()


@pytest.mark.parametrize("displacement", DISPLACEMENTS)
def test_faces_that_bound_the_hand_are_those_of_the_displaced_box(
    displacement: Displacement,
) -> None:
    """Whatever is wanted: as fast outwards as is allowed, along the axes of the box."""
    planner = planner_before(displacement)
    start = np.array(planner.workspace.start_configuration)
    base = BoxPose(*displacement, *ORIGIN).base_frame()
    ik = DifferentialIk(start, HAND_DOWN, base)
    rng = np.random.default_rng(9)
    bound = 0
    for _ in range(30):
        q = start + rng.uniform(-0.1, 0.1, 7)
        at = ik.place(q)
        wanted_in_box = rng.uniform(-0.2, 0.2, 3)
        outwards = np.where(rng.random(6) < 0.5, rng.uniform(0.0, 0.05, 6), np.inf)
        velocity = base.vectors_to_base(wanted_in_box)
        v = ik.solve(at, velocity, np.full(7, -2.0), np.full(7, 2.0), 5.0, outwards)
        assert v is not None
        ahead, _ = hand_by_mujoco(q + 1e-6 * v, displacement)
        behind, _ = hand_by_mujoco(q - 1e-6 * v, displacement)
        moved = (ahead - behind) / 2e-6
        excess = np.concatenate((-moved, moved)) - outwards
        assert excess.max() < 1e-6
        bound += int(excess.max() > -1e-6)
    assert bound > 10, "the faces hardly mattered: nothing is shown"


@pytest.mark.parametrize("late", [8, 15])
def test_a_late_splice_goes_on_in_the_displaced_box(late: int) -> None:
    displacement = DISPLACEMENTS[0]
    planner = planner_before(displacement)
    goal = np.array(planner.workspace.start) + np.array([0.0, 0.1, 0.0])
    planner.set_target(goal, 0.7)
    for _ in range(15):
        planner.step()
    planner.step(late)
    run = follow(planner, [], settle_cycles=100)
    position, _ = hands(run.q, displacement)
    np.testing.assert_allclose(position[-1], goal, atol=2e-4)
    # Straight on, with what the stop has taken: nothing sideways.
    aside = np.abs(position - goal)[:, [0, 2]]
    assert aside.max() < 1.5e-3


def test_where_planning_resumes_the_hand_moves_along_the_axes_of_the_box() -> None:
    displacement = DISPLACEMENTS[0]
    planner = planner_before(displacement)
    planner.set_target(np.array(planner.workspace.start) + np.array([0.0, 0.1, 0.05]), 0.7)
    for _ in range(15):
        chunk = planner.step()
    q, v, _ = chunk.point(8)
    planner._resume(chunk, 8)
    ahead, _ = hand_by_mujoco(q + 1e-6 * v, displacement)
    behind, _ = hand_by_mujoco(q - 1e-6 * v, displacement)
    moves = (ahead - behind) / 2e-6
    assert np.linalg.norm(moves) > 0.05
    np.testing.assert_allclose(planner._hand.velocity_w, moves, atol=1e-6)
    np.testing.assert_allclose(planner._hand.position_w, hand_by_mujoco(q, displacement)[0])


@pytest.mark.parametrize("displacement", DISPLACEMENTS)
def test_bounds_of_the_hand_are_those_of_the_arm_before_the_displaced_box(
    displacement: Displacement,
) -> None:
    planner = planner_before(displacement)
    workspace = planner.workspace
    arm = ArmKinematics("right")
    to_base = np.linalg.inv(base_in_box(displacement))
    corners = itertools.product(*zip(workspace.low, workspace.high, strict=True))
    most = np.zeros(7)
    for corner in (*corners, workspace.start):
        position = (to_base @ (*corner, 1.0))[:3]
        start = np.array(workspace.start_configuration)
        q = arm.inverse(position, to_base[:3, :3] @ HAND_DOWN, start, max_iterations=50).q
        needed = np.linalg.pinv(arm.jacobian(q))[:, :3]
        most = np.maximum(most, np.linalg.norm(needed, axis=1))
    bounds = planner.hand_bounds
    expected = [float((0.8 * limit / most).min()) for limit in (LAB.acceleration, LAB.jerk)]
    assert bounds.acceleration == pytest.approx(min(2.5, expected[0]), rel=1e-4)
    assert bounds.jerk == pytest.approx(min(40.0, expected[1]), rel=1e-4)
    slowest = float((0.8 * LAB.velocity / most).min())
    assert bounds.speed == pytest.approx(min(0.9 * 0.25, slowest), rel=1e-4)
    # Of a profile so slow that the joints decide.
    slow = replace(LAB, velocity=0.05 * LAB.velocity, jerk=0.05 * LAB.jerk)
    found = derive_hand_bounds(workspace, arm, slow, 0.25)
    assert found.speed == pytest.approx(0.05 * slowest, rel=1e-4)
    assert found.jerk == pytest.approx(0.05 * expected[1], rel=1e-4)
