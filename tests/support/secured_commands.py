"""Commands over the secured link, and what the robot server says of them."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import (
    decode_status,
    encode_chunk,
)
from skewmi.deploy.wire.transport import Link
from skewmi.robot_models import limits as joint_limits
from skewmi.trajectory import TrajectoryChunk

LAB = joint_limits.profile("lab")
STEP = 0.08 * np.array([1, -0.5, 0, 0.5, 0, 1, 0])


def stop_and_rest(link: Link) -> None:
    link.call(topics.YUMI_STOP, 5.0)
    eventually(lambda: describe(link).state == "disarmed")
    assert link.call(topics.YUMI_SCENE_RESET, 5.0, b"0").success


def describe(link: Link) -> RobotDescription:
    return RobotDescription.from_json(link.call(topics.YUMI_DESCRIBE, 5.0).message)


def motion_chunk(description: RobotDescription) -> bytes:
    """A good chunk from where the arm is commanded, due soon."""
    start = np.array(description.commanded_position)
    motion = StartMotion(start, start + STEP, LAB)
    stamp_ns = description.clock_ns + 400_000_000
    chunk = TrajectoryChunk.of(stamp_ns, description.joint_names, motion.trajectory)
    return encode_chunk(chunk)


def server_counts(link: Link) -> tuple[int, int]:
    """Commands that reached the robot server so far: accepted, refused."""
    with_status = link.subscribe(topics.YUMI_STATUS, depth=None)
    deadline = time.monotonic() + 10.0
    heard = 0
    while time.monotonic() < deadline:  # the second is surely newer than this call
        for sample in with_status.drain():
            status = decode_status(sample.payload)
            heard += status.name == "skewmi_robot"
            if heard == 2:
                return int(status.values["accepted"]), int(status.values["refused"])
        time.sleep(0.01)
    raise AssertionError("the robot server does not tell its status")


def eventually(condition: Callable[[], Any], timeout_s: float = 10.0) -> Any:
    deadline = time.monotonic() + timeout_s
    while not (value := condition()):
        assert time.monotonic() < deadline, "never became true"
        time.sleep(0.02)
    return value
