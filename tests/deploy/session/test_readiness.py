"""Waiting for a robot that is not ready yet."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import cast

import pytest
from robot_servers import description

from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.session import readiness
from skewmi.deploy.session.interrupt import StopRequestedError
from skewmi.deploy.session.readiness import wait_until_ready
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.errors import CommandRefusedError


class Waking:
    """A robot server that is ready when it has been asked often enough."""

    def __init__(self, after: int) -> None:
        self.asked = 0
        self._after = after

    def describe(self) -> RobotDescription:
        self.asked += 1
        ready = self.asked > self._after
        return replace(description(), ready=ready, not_ready="" if ready else "the motors are off")


def wait(robot: Waking, stop: threading.Event, *, dry_run: bool = False) -> RobotDescription:
    return wait_until_ready(cast(RobotClient, robot), stop, dry_run=dry_run)


def test_it_waits_until_the_robot_is_ready() -> None:
    robot = Waking(3)
    assert wait(robot, threading.Event()).ready
    assert robot.asked == 4


def test_it_gives_up_with_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(readiness, "READY_TIMEOUT_S", 0.1)
    with pytest.raises(CommandRefusedError, match=r"not ready after 0\.1 s: the motors are off"):
        wait(Waking(1_000_000), threading.Event())


def test_waiting_can_be_ended() -> None:
    stop = threading.Event()
    stop.set()
    with pytest.raises(StopRequestedError):
        wait(Waking(1_000_000), stop)


def test_a_dry_run_waits_for_nothing() -> None:
    robot = Waking(1_000_000)
    assert not wait(robot, threading.Event(), dry_run=True).ready
    assert robot.asked == 1
