"""A known motion is carried out once, whole: late rest after its end counts for nothing."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from loop_bench import Bench, Q, arm_state
from virtual_robot import VirtualRobot

from skewmi.deploy.motion.joint_path import JointPath
from skewmi.deploy.motion.path_motion import PathMotion
from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.safety.checks import SpaceChecks
from skewmi.deploy.safety.flange_space import CALIBRATION, CLEAR_HIGH, CLEAR_LOW, FlangeSpace
from skewmi.deploy.session.approach import Approach
from skewmi.deploy.session.joint_run import JointRun, KnownMotion
from skewmi.deploy.session.path_follower import PathFollower
from skewmi.errors import LimitViolationError
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import CYCLE_NS, CYCLE_TICKS, GRID_NS, Array, JointTrajectory

LAB = joint_limits.profile("lab")
PATH = JointPath.line(Q, Q + 0.05)
MOTION = PathMotion(PATH.motion(0.0, 1.0, LAB, 0.2), LAB)
LAST = MOTION.cycles - 1
LEAD_NS = 80_000_000
TABLE = np.array(yumi.TABLE_CONFIGURATION)


def late_at(bench: Bench, chunk: int, patch: pytest.MonkeyPatch) -> None:
    """Hold the session up for a cycle before its chunk of that number is planned, once."""
    due, asked = bench.stream.due, iter(range(10_000))

    def delayed(stamp_ns: int, received_ns: int) -> Iterator[int]:
        for splice in due(stamp_ns, received_ns):
            late = next(asked) == chunk
            bench.stream._next_ns += CYCLE_NS * late
            yield splice + CYCLE_TICKS * late

    patch.setattr(bench.stream, "due", delayed)


@pytest.mark.parametrize(
    ("chunk", "late"),
    [(0, False), (1, True), (LAST, True), (LAST + 1, False), (LAST + 2, False)],
)
def test_only_lateness_before_the_end_of_the_motion_counts(
    chunk: int, late: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench()
    late_at(bench, chunk, monkeypatch)
    way = KnownMotion(MOTION, bench.stream)
    bench.loop.run(way, Q, arm_state(0))
    assert way.late is late
    assert way.all_sent is not late
    if not late:
        assert bench.stream.sent is not None
        np.testing.assert_array_equal(bench.stream.sent.trajectory.q[-1], MOTION.trajectory.q[-1])


class Recorded(VirtualRobot):
    """Refuses what is told, and keeps where each chunk began.

    Args:
        refused: Numbers of the chunks that come too late.
    """

    def __init__(self, *refused: int) -> None:
        # So long that some chunks that only rest follow the motion.
        super().__init__(Q, LEAD_NS)
        self._refuse, self.count = set(refused), 0

    def put(self, payload: bytes) -> None:
        if self.count in self._refuse:
            self.now_ns += 2 * LEAD_NS
        self.count += 1
        super().put(payload)


def follow(robot: Recorded, motion: PathMotion) -> list[str]:
    """As a run does; what it tells."""
    told: list[str] = []
    run = JointRun.__new__(JointRun)
    run._loop, run._stream, run._tell = robot.loop, robot.stream, told.append
    run._approach = Approach(robot.loop, robot.stream, LAB)
    run._follow(motion, robot.next_state())
    return told


@pytest.mark.parametrize("there_and_back", [False, True])
@pytest.mark.parametrize(("place", "again"), [(0, 1), (5, 1), (-3, 1), (0.0, 0), (1.0, 0)])
def test_a_motion_is_repeated_if_some_of_it_was_refused_and_not_if_rest_was(
    place: float, again: int, there_and_back: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = MOTION.trajectory
    if there_and_back:
        back = JointTrajectory(rows.q[::-1], -rows.v[::-1], rows.a[::-1])
        rows = JointTrajectory.concatenate(rows, back.part(slice(1, None)))
    motion = PathMotion(rows, LAB)
    # An integer counts the motion's chunks, another number those of the rest after it.
    number = place % motion.cycles if isinstance(place, int) else motion.cycles + round(place)
    robot = Recorded(number)
    robot.keeps_time(monkeypatch)
    told = follow(robot, motion)
    assert robot.refused >= 1
    assert len(told) == again
    np.testing.assert_allclose(robot.held, rows.q[-1], atol=1e-9)
    # No part of it was left out.
    ticks = range(robot.chunks[0].stamp_ns, robot.chunks[-1].stamp_ns + CYCLE_NS, GRID_NS)
    followed = np.array([robot._measured(tick) for tick in ticks])
    whole = [np.abs(followed - q).max(axis=1).min() for q in rows.q[::7]]
    assert max(whole) < 1e-9


def test_a_way_along_a_path_is_not_begun_anew_for_late_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = Bench()
    parts: Any = SimpleNamespace()
    checks: Any = SimpleNamespace(speeds={"here": 0.2}, now="here")
    status: Any = bench.status
    follower = PathFollower(parts, parts, bench.stream, bench.loop, checks, LAB, 0.1, status)
    follower.q = Q
    cycles = follower.motion(PATH, 0.0, 1.0, None).cycles
    late_at(bench, cycles + 1, monkeypatch)
    begun: list[Array] = []
    begin = bench.stream.begin

    def noted(q: Array, stamp_ns: int) -> None:
        begun.append(q)
        begin(q, stamp_ns)

    monkeypatch.setattr(bench.stream, "begin", noted)
    follower.move(PATH, 0.0, 1.0, arm_state(0))
    assert len(begun) == 1
    np.testing.assert_allclose(follower.q, PATH.at(1.0), atol=1e-12)


def looking(space: FlangeSpace) -> JointRun:
    """A run that is about to look at its motion."""
    run = JointRun.__new__(JointRun)
    run._stages, run._limits, run._stop = SpaceChecks(LAB, space).stages, LAB, threading.Event()
    return run


def test_a_motion_that_leaves_its_workspace_is_noticed_before_the_arm_moves() -> None:
    ends = TABLE, TABLE + np.array([-0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    low, high = (ArmKinematics("right").forward(q)[0][1] for q in sorted(ends, key=lambda q: q[0]))
    assert low + 0.05 < high
    inside = FlangeSpace(CALIBRATION, CLEAR_LOW, CLEAR_HIGH)
    narrow = FlangeSpace(CALIBRATION, (0.2, high - 0.02, 0.17), CLEAR_HIGH)
    motion = PathMotion(JointPath.line(TABLE, ends[1]).motion(0.0, 1.0, LAB, 0.2), LAB)
    looking(inside)._check(motion)
    with pytest.raises(LimitViolationError, match="outside the workspace"):
        looking(narrow)._check(motion)


def test_a_way_back_that_leads_out_is_noticed_before_the_arm_moves() -> None:
    """The way in is allowed from anywhere, the same way back is not."""
    arm, rest = ArmKinematics("right"), JointTrajectory.resting(TABLE, 2)
    nearer = -arm.jacobian(TABLE)[0]
    near = TABLE + 0.1 * nearer / np.linalg.norm(nearer)
    (x, *_), (near_x, *_) = (arm.forward(q)[0] for q in (TABLE, near))
    assert near_x < x - 0.01
    for low, allowed in ((near_x - 0.001, True), (near_x + 0.001, False)):
        run = looking(FlangeSpace(CALIBRATION, (low, -0.4, 0.17), CLEAR_HIGH))
        run._check(StartMotion(near, TABLE, LAB))
        if allowed:
            run._check_ways(near, rest)
            continue
        with pytest.raises(LimitViolationError, match="outside the workspace"):
            run._check_ways(near, rest)
