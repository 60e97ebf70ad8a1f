"""Waiting for a robot that is not ready yet."""

from __future__ import annotations

import threading
import time

from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.session.interrupt import StopRequestedError
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.errors import CommandRefusedError

READY_TIMEOUT_S = 10.0
"""How long a robot may take: a controller's program starts again after a reset of its scene."""

_ASKED_EVERY_S = 0.05


def wait_until_ready(
    robot: RobotClient, stop: threading.Event, *, dry_run: bool
) -> RobotDescription:
    """Wait until a robot could be commanded.

    Args:
        robot: To ask.
        stop: Ends the waiting.
        dry_run: Whether it is not to be commanded anyway: then there is nothing to wait for.

    Returns:
        What the robot server says then.

    Raises:
        StopRequestedError: `stop` was set.
        CommandRefusedError: What is missing after `READY_TIMEOUT_S`.
        TransportError: It does not answer.
    """
    deadline = time.monotonic() + READY_TIMEOUT_S
    while not (description := robot.describe()).ready and not dry_run:
        if time.monotonic() > deadline:
            raise CommandRefusedError(
                f"the robot is not ready after {READY_TIMEOUT_S:g} s: {description.not_ready}"
            )
        if stop.wait(_ASKED_EVERY_S):
            raise StopRequestedError("interrupted")
    return description
