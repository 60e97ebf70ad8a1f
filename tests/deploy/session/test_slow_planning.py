"""However long a motion takes to plan, its first chunk is not late; and a moved arm is noticed."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_servers import robot_in_a_thread
from virtual_robot import VirtualRobot

from skewmi.cli.main import main
from skewmi.deploy.motion.joint_path import JointPath
from skewmi.deploy.motion.path_motion import PathMotion
from skewmi.deploy.session import approach as approach_module
from skewmi.deploy.session import path_follower as follower_module
from skewmi.deploy.session.approach import START_ATTEMPTS, Approach
from skewmi.deploy.session.joint_run import JointRun
from skewmi.deploy.session.path_follower import ATTEMPTS, OFF_PATH, PathFollower
from skewmi.deploy.session.refused import ReferenceMovedError
from skewmi.deploy.session.touch_run import TouchRun
from skewmi.errors import CommandRefusedError
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi

LAB = joint_limits.profile("lab")
Q = np.array(yumi.TABLE_CONFIGURATION)
GOAL = Q + 0.02
PATH = JointPath.line(Q, GOAL)
LEADS_NS = (8_000_000, 24_000_000, 100_000_000)
SLOWEST_NS = 400_000_000

slow = st.integers(0, SLOWEST_NS)
leads = st.sampled_from(LEADS_NS)


class Nothing:
    """A watch that never meets anything."""

    touched, force = False, 0.0

    def begin(self, *_: object) -> None: ...

    def look(self, *_: object) -> None: ...


@contextmanager
def robot_with(
    lead_ns: int, planning: Callable[[VirtualRobot], None]
) -> Iterator[tuple[VirtualRobot, pytest.MonkeyPatch]]:
    """A robot in virtual time; `planning` is called in the middle of every planning."""
    robot = VirtualRobot(Q, lead_ns)

    def slowed(make: Callable[..., Any]) -> Callable[..., Any]:
        def planned(*arguments: Any, **options: Any) -> Any:
            planning(robot)
            return make(*arguments, **options)

        return planned

    with pytest.MonkeyPatch.context() as patch:
        robot.keeps_time(patch)
        for module, name in ((approach_module, "StartMotion"), (follower_module, "PathMotion")):
            patch.setattr(module, name, slowed(getattr(module, name)))
        yield robot, patch


def follower(robot: VirtualRobot) -> PathFollower:
    parts: Any = robot
    checks: Any = SimpleNamespace(speeds={"here": 0.2}, now="here")
    status: Any = robot.status
    made = PathFollower(parts, parts, robot.stream, robot.loop, checks, LAB, 0.1, status)
    made.q = Q
    return made


def touch_run(robot: VirtualRobot) -> TouchRun:
    parts: Any = robot
    checks: Any = SimpleNamespace(speeds={"here": 0.2}, now="here")
    how: Any = SimpleNamespace(limits=LAB, tool_z=0.1, force_limit=10.0)
    run = TouchRun(
        *(parts, parts, robot.stream, robot.loop, checks, how, Nothing()),  # type: ignore[arg-type]
        *(robot.status, robot.stop),  # type: ignore[arg-type]
        lock_step=False,
        tell=lambda text: None,
    )
    run._way.q = Q
    return run


def begin_approach(robot: VirtualRobot) -> None:
    Approach(robot.loop, robot.stream, LAB).run(GOAL, Q, robot.next_state())


def begin_path(robot: VirtualRobot) -> None:
    follower(robot).move(PATH, 0.0, 1.0, robot.next_state())


def begin_touch(robot: VirtualRobot) -> None:
    touch_run(robot)._guarded(PATH, np.eye(3)[0], 0.05, robot.next_state())


MOTIONS = {"approach": begin_approach, "path": begin_path, "touch": begin_touch}


@pytest.mark.parametrize("kind", MOTIONS)
@settings(deadline=None, max_examples=15)
@given(slow, leads)
def test_planning_takes_nothing_from_the_lead(kind: str, planning_ns: int, lead_ns: int) -> None:
    def plan_slowly(robot: VirtualRobot) -> None:
        robot.now_ns += planning_ns

    with robot_with(lead_ns, plan_slowly) as (robot, _):
        MOTIONS[kind](robot)
    assert robot.refused == robot.stream.missed_cycles == 0
    np.testing.assert_allclose(robot.held, GOAL, atol=1e-12)
    stamps = np.array([chunk.stamp_ns for chunk in robot.chunks])
    assert (np.diff(stamps) == 20_000_000).all(), "begun once, and never interrupted"


@settings(deadline=None, max_examples=15)
@given(slow, leads)
def test_a_motion_known_beforehand_begins_now_however_old_the_state_is(
    age_ns: int, lead_ns: int
) -> None:
    with robot_with(lead_ns, lambda robot: None) as (robot, _):
        state = robot.next_state()
        robot.now_ns += age_ns
        run = JointRun.__new__(JointRun)
        run._loop, run._stream, run._tell = robot.loop, robot.stream, lambda text: None
        run._follow(PathMotion(PATH.motion(0.0, 1.0, LAB, 0.05), LAB), state)
    assert robot.refused == robot.stream.missed_cycles == 0


@pytest.mark.parametrize("kind", MOTIONS)
def test_an_arm_that_is_moved_while_a_motion_is_planned_has_it_planned_anew(kind: str) -> None:
    off = 0.01 * OFF_PATH * np.array([1, -1, 1, -1, 1, -1, 1])
    moves = iter([off])

    def disturbed(robot: VirtualRobot) -> None:
        robot.held = robot.held + next(moves, 0.0)

    with robot_with(24_000_000, disturbed) as (robot, _):
        MOTIONS[kind](robot)
    np.testing.assert_allclose(robot.chunks[0].trajectory.q[0], Q + off, atol=1e-12)
    np.testing.assert_allclose(robot.held, GOAL, atol=OFF_PATH)
    assert robot.refused == robot.stream.missed_cycles == 0


@pytest.mark.parametrize(
    ("kind", "attempts"),
    [("approach", START_ATTEMPTS), ("path", ATTEMPTS), ("touch", ATTEMPTS)],
)
def test_an_arm_that_is_moved_again_and_again_is_given_up_on(kind: str, attempts: int) -> None:
    def disturbed(robot: VirtualRobot) -> None:
        robot.held = robot.held + 1e-6

    with (
        robot_with(24_000_000, disturbed) as (robot, _),
        pytest.raises(CommandRefusedError, match=f"{attempts} .*planned for nothing.*anybody else"),
    ):
        MOTIONS[kind](robot)
    assert not robot.chunks, "nothing was sent"


@pytest.mark.parametrize("kind", ["path", "touch"])
def test_an_arm_that_was_moved_off_its_path_is_not_led_on(kind: str) -> None:
    def disturbed(robot: VirtualRobot) -> None:
        robot.held = Q + 2.0 * OFF_PATH * np.array([1, -1, 1, -1, 1, -1, 1])

    with (
        robot_with(24_000_000, disturbed) as (robot, _),
        pytest.raises(CommandRefusedError, match="somebody has moved it; start again"),
    ):
        MOTIONS[kind](robot)
    assert not robot.chunks, "nothing was sent"


def test_a_moved_arm_is_no_late_chunk() -> None:
    robot = VirtualRobot(Q, 24_000_000)
    with pytest.raises(ReferenceMovedError):
        robot.loop.run(None, Q + 0.1, robot.next_state())  # type: ignore[arg-type]


def test_jogging_with_a_planner_slower_than_the_lead(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On a robot server in real time, with the longest lead, so that a busy computer matters
    little: whatever is sent in time on it is sent in time after a slow plan."""
    make, wait = follower_module.PathMotion, threading.Event().wait

    def slowly(*arguments: Any) -> PathMotion:
        wait(0.2)
        return make(*arguments)

    monkeypatch.setattr(follower_module, "PathMotion", slowly)
    with robot_in_a_thread() as locator:
        assert main(["jog", "--z", "1", "--connect", locator, "--lead-ms", "100"]) == 0
    assert "stopped" not in capsys.readouterr().out
