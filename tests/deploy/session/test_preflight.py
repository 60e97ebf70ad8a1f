"""Where episodes start, and whether the way there is free."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from moved_boxes import ORIGIN, Displacement, hand_by_mujoco

from skewmi.box_frame import placed
from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.backends.mujoco.scene_geometry import scene_geometry
from skewmi.deploy.safety.checks import ChunkChecks
from skewmi.deploy.safety.guard import Guard
from skewmi.deploy.safety.obstacles import scene_obstacles
from skewmi.deploy.session.preflight import check_way, draw_start
from skewmi.errors import (
    LimitViolationError,
)
from skewmi.policy_io import Workspace
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi
from skewmi.robot_models.base_frame import BaseFrame, BoxPose
from skewmi.robot_models.frames import HAND_DOWN
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.sim import tasks
from skewmi.sim.arm.scene import ArmScene
from skewmi.sim.tasks.open_press_close.definition import make_layout

LAB = joint_limits.profile("lab")


@pytest.mark.parametrize("far", [False, True])
def test_starts_lie_around_the_tasks_start(far: bool) -> None:
    workspace = make_layout().workspace
    assert workspace is not None
    posture = np.array(workspace.start_configuration)
    near = np.array(yumi.HOME["right"]) if far else posture + 0.01
    forward = ArmKinematics("right").forward
    starts = []
    for seed in range(5):
        q = draw_start(workspace, seed, 0.005, near)
        assert (q == draw_start(workspace, seed, 0.005, near)).all()
        hand = forward(q)[0] + np.array(workspace.base_position)
        starts.append(hand)
        assert np.abs(hand - np.array(workspace.start)).max() < 0.005 + 1e-4
        assert np.abs(q - posture).max() < 0.2
    assert np.ptp(starts, axis=0).min() > 1e-3


@pytest.mark.parametrize("displacement", [(0.02, -0.012, 8.0), (-0.02, 0.02, -10.0)])
def test_starts_before_a_displaced_box_lie_around_its_start(displacement: Displacement) -> None:
    nominal = make_layout().workspace
    assert nominal is not None
    workspace = placed(nominal, BoxPose(*displacement, *ORIGIN))
    for seed, near in enumerate((yumi.TABLE_CONFIGURATION, yumi.HOME["right"])):
        q = draw_start(workspace, seed, 0.005, np.array(near))
        hand, turn = hand_by_mujoco(q, displacement)
        # The same draw as before a box in its place, in the box's frame.
        plain = draw_start(nominal, seed, 0.005, np.array(near))
        np.testing.assert_allclose(hand, hand_by_mujoco(plain, (0.0, 0.0, 0.0))[0], atol=1e-5)
        np.testing.assert_allclose(turn, HAND_DOWN, atol=1e-5)


def test_whole_way_to_the_start_is_checked_before_anything_moves() -> None:
    workspace = make_layout().workspace
    assert workspace is not None
    checks = ChunkChecks(LAB, workspace)
    q_goal = np.array(workspace.start_configuration)
    check_way(q_goal + 0.02, q_goal, LAB, checks)
    # Both ends are clear by more than is asked for; the way leads past the other arm.
    guard = Guard(LAB, clearance=0.02)
    checks = SimpleNamespace(stages=[("guard", lambda way, *_: guard.check(way.q, way.v, way.a))])
    ends = [-2.5, -1.4, -0.4, 1.2, 0.6, -0.5, -2.0], [1.3, -2.4, 1.5, -0.3, 4.3, -1.2, 2.7]
    for end in map(np.array, ends):
        guard.check(np.tile(end, (6, 1)), np.zeros((6, 7)), np.zeros((6, 7)))
    with pytest.raises(LimitViolationError, match="clearance"):
        check_way(*map(np.array, ends), LAB, checks)


BESIDE = {
    # The hand stands beside the box, clear of it, as after a touch that was stopped.
    "open_press_close": [1.8236, -0.2399, -2.6736, 0.3628, -2.3459, 0.1352, 0.3113],
    "door_open": [1.682, -1.3442, -2.3147, 0.9561, -2.9891, 1.6459, 3.4927],
}


def before_the_scene(task: str, known: bool = True) -> tuple[Workspace, ChunkChecks]:
    layout, arm = tasks.layout(task), tasks.find(task).arm
    assert layout.workspace is not None
    assert arm is not None
    parts = scene_geometry(ArmScene(arm).model).parts
    return layout.workspace, ChunkChecks(
        LAB, layout.workspace, obstacles=scene_obstacles(parts) if known else ()
    )


@pytest.mark.parametrize("task", sorted(BESIDE))
def test_a_way_from_beside_the_box_keeps_clear_of_the_scene(task: str) -> None:
    q = np.array(BESIDE[task])
    workspace, checks = before_the_scene(task)
    q_goal = draw_start(workspace, 1, 0.0, q)
    checks.begin_way(q)
    with pytest.raises(LimitViolationError, match=r"to scene.*skewmi home"):
        check_way(q, q_goal, LAB, checks)
    # Every chunk that leads there is refused, too, before the arm touches anything.
    motion = StartMotion(q, q_goal, LAB)
    guard = dict(checks.stages)["guard"]

    def send() -> None:
        for cycle in range(motion.cycles):
            chunk = motion.chunk(cycle)
            guard(chunk, chunk.point(0), chunk.q[:1])

    with pytest.raises(LimitViolationError, match="to scene"):
        send()
    # Nobody tells what stands there: then nothing is known of it.
    _, blind = before_the_scene(task, known=False)
    blind.begin_way(q)
    check_way(q, q_goal, LAB, blind)


@pytest.mark.parametrize("task", sorted(BESIDE))
def test_ways_from_home_and_from_inside_the_box_are_as_free_as_ever(task: str) -> None:
    """Inside, the hand is where it works: it may touch what it is there for."""
    workspace, checks = before_the_scene(task)
    base = BaseFrame.of(workspace)
    posture = np.array(workspace.start_configuration)
    rng = np.random.default_rng(3)
    places = rng.uniform(workspace.low, workspace.high, (10, 3))
    inside = ArmKinematics("right").inverse(
        base.to_base(places),
        np.tile(base.rotations_to_base(HAND_DOWN), (10, 1, 1)),
        np.tile(posture, (10, 1)),
        posture=posture,
        max_iterations=50,
    )
    for q in (np.array(yumi.TABLE_CONFIGURATION), posture, *inside.q):
        checks.begin_way(q)
        check_way(q, draw_start(workspace, 0, 0.005, q), LAB, checks)


def test_from_beside_the_box_after_an_episode_the_scene_counts_again() -> None:
    q = np.array(BESIDE["door_open"])
    workspace, checks = before_the_scene("door_open")
    checks.begin_way(np.array(workspace.start_configuration))
    checks.begin_way(q)
    with pytest.raises(LimitViolationError, match="clearance"):
        check_way(q, draw_start(workspace, 1, 0.0, q), LAB, checks)
