"""`skewmi home` after a touch that was cut off, and cut off itself at any moment.

The commands are processes of their own, and are killed.
"""

from __future__ import annotations

import json
import os
import random
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from executed_limits import assert_within_limits, start_command, wait_for, wait_for_state
from robot_servers import call, describe
from watched_robot import assert_kept, robot_at
from way_scenes import task_start

from skewmi.cli.main import main
from skewmi.cli.scene_touches import TouchPlanner
from skewmi.deploy.recording.recorder import Recorder
from skewmi.deploy.robot.description import SCENE_REQUEST, RobotDescription
from skewmi.deploy.robot.process import EMULATOR, spawn_robot
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import TransportConfig
from skewmi.errors import ConfigurationError
from skewmi.robot_models import limits, yumi
from skewmi.robot_models.servo import CONTACT_SERVO

pytestmark = pytest.mark.slow

LARGEST_FORCE = 15.0
"""N."""


def plan_touches(robot: str) -> int:
    described = RobotDescription.from_json(call(robot, topics.YUMI_DESCRIBE, SCENE_REQUEST)[1])
    lab = limits.profile("lab")
    return len(TouchPlanner(described, lab, CONTACT_SERVO, lambda text: None).touches())


def kill(robot: str, after: bytes, longest_s: float, *arguments: str) -> None:
    """Begin a command, and kill it some time after it has said something."""
    child = start_command(robot, *arguments, "--lock-step")
    wait_for(after, child)
    time.sleep(random.Random(str(arguments)).uniform(0.0, longest_s))
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    # Time stands still in lock-step while nobody sends: what was sent is followed after a stop.
    assert main(["stop", "--connect", robot]) == 0
    assert describe(robot).state == "disarmed"


def test_a_hand_that_a_killed_calibration_left_beside_the_box_is_led_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with robot_at(task_start(), monkeypatch) as (robot, seen):
        kill(robot, b"touched the", 0.0, "calibrate", "scene", "--out", str(tmp_path / "own.yaml"))
        with pytest.raises(ConfigurationError, match="skewmi home"):
            plan_touches(robot)
        for phase in (b"straight up", b"across"):
            kill(robot, phase, 1.0, "home")
        assert main(["home", "--connect", robot, "--lock-step", "--json"]) == 0
        after = describe(robot)
        assert plan_touches(robot) == 6
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["stops"] == []
    np.testing.assert_allclose(after.commanded_position, task_start(), atol=1e-9)
    assert after.contact["hand_force_peak_n"] <= LARGEST_FORCE
    assert_kept(seen)


def test_home_that_is_killed_in_real_time_ends_at_rest_within_limits(tmp_path: Path) -> None:
    path = tmp_path / "watched.mcap"
    with spawn_robot("sim", "open_press_close", "lab", lock_step=False) as robot:
        with Recorder.start(path, TransportConfig.for_client(robot)) as recorder:
            child = start_command(robot, "home", "--to", "home")
            wait_for(b"across", child)
            time.sleep(random.Random(str(tmp_path)).uniform(0.5, 1.5))
            os.kill(child.pid, signal.SIGKILL)
            child.wait()
            wait_for_state(robot, "disarmed")
            time.sleep(0.5)
        recorder.close()
    assert_within_limits(path)


def test_home_and_back_through_an_emulated_controller() -> None:
    """Its own cycle is not the grid's; workspaces are changed on the way, at a long lead."""
    with spawn_robot(EMULATOR, "open_press_close", "lab", lock_step=False) as robot:
        deadline = time.monotonic() + 60.0
        while not describe(robot).ready:
            assert time.monotonic() < deadline
            time.sleep(0.2)
        assert main(["home", "--to", "home", "--connect", robot]) == 0
        there = describe(robot).commanded_position
        np.testing.assert_allclose(there, yumi.HOME["right"], atol=1e-6)
        assert main(["home", "--connect", robot]) == 0
        np.testing.assert_allclose(describe(robot).commanded_position, task_start(), atol=1e-6)
