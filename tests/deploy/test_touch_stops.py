"""Touching that is killed at any moment: the arm rests, kept its limits, and pressed gently."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from executed_limits import (
    assert_within_limits,
    start_calibration,
    wait_for,
    wait_for_state,
)
from robot_servers import describe

from skewmi.cli.main import main
from skewmi.deploy.recording.recorder import Recorder
from skewmi.deploy.robot.process import spawn_robot
from skewmi.deploy.wire.transport import TransportConfig

LARGEST_FORCE = 15.0
"""N."""


@pytest.fixture
def robot() -> Iterator[str]:
    """Locator of one whose hand stands where tasks start: not where the last test left it, beside
    the box, from where no touches are planned."""
    with spawn_robot("sim", "open_press_close", "lab", lock_step=False) as locator:
        yield locator


def start(robot: str, out: Path) -> subprocess.Popen[bytes]:
    return start_calibration(robot, "scene", "--lead-ms", "100", "--out", str(out))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("phase", "longest_s"),
    [(b"touch 1 of", 4.0), (b"touched the", 0.0), (b"touched the", 1.5), (b"touch 2 of", 8.0)],
)
def test_killed_touching_ends_at_rest_within_limits_and_forces(
    robot: str, tmp_path: Path, phase: bytes, longest_s: float
) -> None:
    path = tmp_path / "watched.mcap"
    with Recorder.start(path, TransportConfig.for_client(robot)) as recorder:
        child = start(robot, tmp_path / "own.yaml")
        wait_for(phase, child)
        time.sleep(random.Random(str(tmp_path)).uniform(0.0, longest_s))
        os.kill(child.pid, signal.SIGKILL)
        child.wait()
        wait_for_state(robot, "disarmed")
        time.sleep(0.5)
    recorder.close()
    assert_within_limits(path)
    assert describe(robot).contact["hand_force_peak_n"] <= LARGEST_FORCE
    assert not (tmp_path / "own.yaml").exists()


@pytest.mark.slow
def test_touching_that_is_stopped_says_so(robot: str, tmp_path: Path) -> None:
    path = tmp_path / "watched.mcap"
    with Recorder.start(path, TransportConfig.for_client(robot)) as recorder:
        child = start(robot, tmp_path / "own.yaml")
        wait_for(b"touched the", child)
        assert main(["stop", "--connect", robot]) == 0
        assert child.wait(20.0) == 1
        wait_for_state(robot, "disarmed")
        time.sleep(0.5)
    recorder.close()
    assert_within_limits(path)
    assert describe(robot).contact["hand_force_peak_n"] <= LARGEST_FORCE
