"""An excitation that is stopped or killed at any moment: the arm rests, and kept its limits."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from robot_servers import describe

from skewmi.child import child_command
from skewmi.cli.main import main
from skewmi.deploy.recording.joint_series import executed_reference
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.recording.recorder import Recorder
from skewmi.deploy.safety.flange_space import CALIBRATION, FlangeSpace, lowest_of_hand
from skewmi.deploy.wire.transport import TransportConfig
from skewmi.robot_models import limits
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import GRID_NS, GRID_S, Array

TOLERANCE = 0.005
"""What the robot server allows outside, m."""


def start(robot: str, out: Path) -> subprocess.Popen[bytes]:
    command = child_command("-m", "skewmi.cli.main", "calibrate", "excite", "--connect", robot)
    return subprocess.Popen(
        [*command, "--seconds", "10", "--out", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )


def wait_for(words: bytes, child: subprocess.Popen[bytes]) -> None:
    assert child.stderr is not None
    for line in child.stderr:
        if words in line:
            return
    pytest.fail(f"it ended before {words!r}")


def wait_for_state(robot: str, state: str) -> None:
    deadline = time.monotonic() + 10.0
    while describe(robot).state != state:
        assert time.monotonic() < deadline
        time.sleep(0.05)


def assert_kept(path: Path, robot: str) -> None:
    """Limits restated: differences of what was executed, every 4 ms, and where the hand was."""
    told = executed_reference(read_recording(path))
    executed, profile = told.reference, limits.profile("lab")
    # A busy computer loses some; differences are taken where there are four in a row.
    rows = np.flatnonzero(told.stamps_ns[3:] - told.stamps_ns[:-3] == 3 * GRID_NS)
    assert len(rows) > 0.5 * len(executed)
    first, second, third, fourth = (executed.q[rows + k] for k in range(4))
    velocity: Array = (second - first) / GRID_S
    acceleration: Array = (third - 2.0 * second + first) / GRID_S**2
    jerk: Array = (fourth - 3.0 * third + 3.0 * second - first) / GRID_S**3
    for name, values, bound in (
        ("velocity", velocity, profile.velocity),
        ("acceleration", acceleration, profile.acceleration),
        ("jerk", jerk, profile.jerk),
    ):
        assert (np.abs(values).max(axis=0) <= 1.0001 * bound).all(), name
    assert not executed.v[-1].any()
    assert np.abs(velocity).max() > 0.1, "nothing moved"
    position, rotation = ArmKinematics("right").forward(executed.q)
    speed = np.linalg.norm(position[rows + 1] - position[rows], axis=1) / GRID_S
    assert speed.max() <= 0.2501
    space = FlangeSpace.from_numbers(CALIBRATION, describe(robot).workspaces[CALIBRATION])
    up = np.flatnonzero(lowest_of_hand(position, rotation) >= space.fingers_above)
    assert (position[up[0] :] >= np.array(space.low) - TOLERANCE).all()
    assert (position[up[0] :] <= np.array(space.high) + TOLERANCE).all()
    assert (lowest_of_hand(position, rotation)[up[0] :] >= space.fingers_above - TOLERANCE).all()


@pytest.mark.slow
@pytest.mark.parametrize("phase", [b"moving to where", b"moving for", b"moving back"])
def test_a_killed_excitation_ends_at_rest_within_limits(
    robot: str, tmp_path: Path, phase: bytes
) -> None:
    path = tmp_path / "watched.mcap"
    with Recorder.start(path, TransportConfig.for_client(robot)) as recorder:
        child = start(robot, tmp_path / "own.mcap")
        wait_for(phase, child)
        # Ways take a second or two, the motion ten.
        longest = 6.0 if phase == b"moving for" else 1.0
        time.sleep(random.Random(str(tmp_path)).uniform(0.3, longest))
        os.kill(child.pid, signal.SIGKILL)
        child.wait()
        wait_for_state(robot, "disarmed")
        time.sleep(0.5)
    recorder.close()
    assert_kept(path, robot)


@pytest.mark.slow
def test_stopping_an_excitation_is_told(robot: str, tmp_path: Path) -> None:
    path = tmp_path / "watched.mcap"
    with Recorder.start(path, TransportConfig.for_client(robot)) as recorder:
        child = start(robot, tmp_path / "own.mcap")
        wait_for(b"moving for", child)
        time.sleep(1.0)
        assert main(["stop", "--connect", robot]) == 0
        assert child.wait(20.0) == 1
        wait_for_state(robot, "disarmed")
        time.sleep(0.5)
    recorder.close()
    assert_kept(path, robot)
    # What was recorded until then is a recording.
    assert read_recording(tmp_path / "own.mcap").complete
