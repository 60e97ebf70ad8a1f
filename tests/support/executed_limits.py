"""What a robot server executed, against its limits restated: for runs that were cut off."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from robot_servers import describe

from skewmi.child import child_command
from skewmi.deploy.recording.joint_series import executed_reference
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.safety.flange_space import CALIBRATION, FlangeSpace, lowest_of_hand
from skewmi.robot_models import limits
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import GRID_NS, GRID_S, Array

TOLERANCE = 0.005
"""What the robot server allows outside, m."""


def start_calibration(robot: str, *arguments: str) -> subprocess.Popen[bytes]:
    """`skewmi calibrate` with these, on a running robot server, in a process of its own."""
    return start_command(robot, "calibrate", *arguments)


def start_command(robot: str, *arguments: str) -> subprocess.Popen[bytes]:
    """`skewmi` with these, on a running robot server, in a process of its own."""
    command = child_command("-m", "skewmi.cli.main", *arguments, "--connect", robot)
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def wait_for(words: bytes, child: subprocess.Popen[bytes]) -> None:
    assert child.stderr is not None
    told = []
    for line in child.stderr:
        if words in line:
            return
        told.append(line)
    pytest.fail(f"it ended before {words!r}, and said {b''.join(told[-5:])!r}")


def wait_for_state(robot: str, state: str) -> None:
    deadline = time.monotonic() + 10.0
    while describe(robot).state != state:
        assert time.monotonic() < deadline
        time.sleep(0.05)


def assert_within_limits(path: Path) -> Array:
    """Differences of what was executed, every 4 ms; and that it ended at rest.

    Returns:
        Joints that were executed, rad. Shape (n, 7).
    """
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
    position, _ = ArmKinematics("right").forward(executed.q)
    speed = np.linalg.norm(position[rows + 1] - position[rows], axis=1) / GRID_S
    assert speed.max() <= 0.2501
    return executed.q


def assert_kept(path: Path, robot: str) -> None:
    """Limits, and where the hand was: clear of the scene once it was up."""
    position, rotation = ArmKinematics("right").forward(assert_within_limits(path))
    space = FlangeSpace.from_numbers(CALIBRATION, describe(robot).workspaces[CALIBRATION])
    up = np.flatnonzero(lowest_of_hand(position, rotation) >= space.fingers_above)
    assert (position[up[0] :] >= np.array(space.low) - TOLERANCE).all()
    assert (position[up[0] :] <= np.array(space.high) + TOLERANCE).all()
    assert (lowest_of_hand(position, rotation)[up[0] :] >= space.fingers_above - TOLERANCE).all()
