"""The tool's speed and the workspace box, on motions of the whole arm."""

from __future__ import annotations

import numpy as np
import pytest
from limit_motions import LAB, MIDDLE, motion, refused

from skewmi.deploy.safety.limits import (
    ChunkChecker,
)
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array, Workspace
from skewmi.robot_models import yumi
from skewmi.robot_models.kinematics import ArmKinematics

BASE = np.array([-0.4, 0.1, 0.2])


def box_around(position_b: Array, half: float) -> Workspace:
    """A cube around a position of the robot base frame, in a world where the base is at BASE."""
    position = position_b + BASE
    return Workspace(
        low=tuple((position - half).tolist()),
        high=tuple((position + half).tolist()),
        start=tuple(position.tolist()),
        base_position=tuple(BASE.tolist()),
        hand_quaternion_wxyz=(1.0, 0.0, 0.0, 0.0),
        free_following_error=1.0,
        held_following_error=0.3,
        stop_blockage=0.45,
        start_configuration=tuple(MIDDLE.tolist()),
        gripper_opening=0.01,
    )


def test_tool_speed() -> None:
    forward = ArmKinematics("right").forward
    q = yumi.HOME["right"]
    lever = np.linalg.norm(ArmKinematics("right").jacobian(q)[:3, 0])
    start = np.array(q)
    end = start + np.array([0.5, 0, 0, 0, 0, 0, 0])
    for speed, good in ((0.24, True), (0.26, False)):
        velocity = np.full(7, speed / lever)
        chunk = motion(start, end, velocity, LAB.acceleration, LAB.jerk)
        checker = ChunkChecker(LAB, forward=forward)
        if good:
            assert checker.check(*chunk).tcp_speed == pytest.approx(0.24 / 0.25, rel=5e-3)
        else:
            assert "tool speed" in refused(checker, chunk).limit


def test_workspace_box_with_tolerance() -> None:
    forward = ArmKinematics("right").forward
    start = np.array(yumi.HOME["right"])
    slow = np.full(7, 0.1)
    end = start + 0.05
    chunk = motion(start, end, slow, LAB.acceleration, LAB.jerk)
    travelled = np.abs(forward(chunk[0])[0] - forward(start)[0]).max()
    position = forward(start)[0]
    inside = ChunkChecker(LAB, box_around(position, travelled - 0.0049), forward)
    expected = travelled / (travelled - 0.0049)
    assert inside.check(*chunk).workspace == pytest.approx(expected, rel=1e-9)
    # A box that lies to one side: the fraction counts from its own middle.
    beside = ChunkChecker(LAB, box_around(position + 0.01, 0.05), forward)
    away = np.abs(forward(chunk[0])[0] - position - 0.01).max()
    assert beside.check(*chunk).workspace == pytest.approx(away / 0.05, rel=1e-9)
    outside = ChunkChecker(LAB, box_around(position, travelled - 0.0051), forward)
    assert "workspace" in refused(outside, chunk).limit


def test_configuration_errors() -> None:
    with pytest.raises(ConfigurationError, match="forward"):
        ChunkChecker(LAB, box_around(np.zeros(3), 1.0))
    with pytest.raises(ConfigurationError, match="grid_dt"):
        ChunkChecker(LAB, grid_dt=0.0)
    with pytest.raises(ConfigurationError, match="tcp_speed"):
        ChunkChecker(LAB, tcp_speed=-1.0)
