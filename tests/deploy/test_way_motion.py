"""`skewmi home` and `skewmi jog` on a robot server in lock-step: limits, rest, and refusals."""

from __future__ import annotations

import json

import numpy as np
import pytest
from robot_servers import describe
from watched_robot import ARM, assert_kept, assert_rests_whoever_is_killed, robot_at
from way_scenes import in_contact, planner, task_start, touches

from skewmi.cli.main import main
from skewmi.deploy.safety.flange_space import CALIBRATION, FINGER_TIP, TOUCH_SPEED
from skewmi.errors import ConfigurationError
from skewmi.sim.tasks.open_press_close.definition import ARM as SCENE
from skewmi.trajectory import GRID_S, Array


def random_pose(seed: int) -> Array:
    """Near the task's start, from where a way exists."""
    rng = np.random.default_rng(seed)
    while True:
        q = task_start() + rng.normal(0.0, 0.15, 7)
        try:
            planner(q).way_to(task_start(), CALIBRATION)
        except ConfigurationError:
            continue
        return q


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 12, 13])
def test_home_from_a_random_pose_is_at_rest_within_limits(
    seed: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with robot_at(random_pose(seed), monkeypatch) as (robot, seen):
        assert main(["home", "--connect", robot, "--lock-step", "--json"]) == 0
        after = describe(robot)
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    np.testing.assert_allclose(told["joints_rad"], task_start(), atol=0.02)
    np.testing.assert_allclose(after.commanded_position, task_start(), atol=1e-9)
    assert after.state == "disarmed"
    assert after.contact["arm_force_peak_n"] == 0.0
    assert_kept(seen)
    assert_rests_whoever_is_killed(seen)


@pytest.mark.slow
def test_a_hand_that_was_left_in_contact_is_led_up_and_back(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    q = in_contact(touches()[0])
    with robot_at(q, monkeypatch) as (robot, seen):
        assert main(["home", "--connect", robot, "--lock-step", "--json"]) == 0
        after = describe(robot)
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["legs"][0] == {"workspace": "touch", "what": "straight up"}
    np.testing.assert_allclose(after.commanded_position, task_start(), atol=1e-9)
    assert_kept(seen)
    assert_rests_whoever_is_killed(seen)
    # Up, and while it is beside the box slowly.
    position, rotation = ARM.forward(seen.q)
    tips = position + FINGER_TIP * rotation[:, :, 2]
    beside = position[:, 2] < position[0, 2] + 0.02
    speed = np.linalg.norm(np.diff(tips, axis=0), axis=1) / GRID_S
    assert speed[beside[1:]].max() <= TOUCH_SPEED
    assert after.contact["hand_force_peak_n"] <= 15.0


def test_jogging_moves_by_what_was_asked_for_and_slowly(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with robot_at(task_start(), monkeypatch) as (robot, seen):
        flags = ["--connect", robot, "--lock-step"]
        assert main(["jog", "--z", "5", "--y", "-3", *flags]) == 0
        position, _ = ARM.forward(seen.q[[0, -1]])
        np.testing.assert_allclose(np.diff(position, axis=0)[0], (0.0, -0.003, 0.005), atol=2e-5)
        before = seen.q[-1]
        assert main(["jog", "--joint", "6", "--degrees", "-1", *flags]) == 0
        turned = np.rad2deg(seen.q[-1] - before)
        np.testing.assert_allclose(turned, (0, 0, 0, 0, 0, 0, -1), atol=1e-6)
        # Into the lid: refused before anything moves.
        count = len(seen.chunks)
        assert main(["jog", "--z", "-50", *flags]) == 2
        assert "clearance" in capsys.readouterr().err
        assert len(seen.chunks) == count
    assert_kept(seen)
    assert_rests_whoever_is_killed(seen)
    tips = (lambda p, r: p + FINGER_TIP * r[:, :, 2])(*ARM.forward(seen.q))
    assert np.linalg.norm(np.diff(tips, axis=0), axis=1).max() / GRID_S <= TOUCH_SPEED


def test_jogging_within_the_tasks_box_cannot_leave_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with robot_at(task_start(), monkeypatch) as (robot, seen):
        flags = ["--connect", robot, "--lock-step", "--workspace", "task"]
        assert main(["jog", "--x", "3", "--z", "40", *flags]) == 0
        position, _ = ARM.forward(seen.q[[0, -1]])
        np.testing.assert_allclose(np.diff(position, axis=0)[0], (0.003, 0.0, 0.04), atol=2e-5)
        assert main(["jog", "--z", "30", *flags]) == 0
        # 15 mm are left above and 7 before the hand.
        count = len(seen.chunks)
        for step in ("--z", "--x"):
            assert main(["jog", step, "40", *flags]) == 2
            assert "outside the workspace" in capsys.readouterr().err
        assert len(seen.chunks) == count
    assert_kept(seen)
    assert_rests_whoever_is_killed(seen)
    moved = ARM.forward(seen.q)[0] - position[0]
    room = np.subtract(SCENE.high, SCENE.start)
    assert (moved.max(axis=0) <= room).all()
    assert room[2] < 0.07 + 0.04
    assert room[0] < 0.003 + 0.04
