"""`skewmi robot`: what it tells."""

from __future__ import annotations

import json
import signal
import subprocess
import sys

from skewmi.deploy.robot.process import free_port
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import Link, TransportConfig


def test_robot_server_tells_each_change_of_state_and_what_it_was_granted() -> None:
    locator = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "skewmi.cli.main", "robot", "--listen", locator, "--json"]
    robot = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert robot.stdout is not None
        assert json.loads(robot.stdout.readline())["state"] == "disarmed"
        with Link.open(TransportConfig.for_client(locator), "test") as link:
            link.wait_for_robot(5.0)
            assert link.call(topics.YUMI_ARM, 5.0, bytes(32)).success
            assert link.call(topics.YUMI_STOP, 5.0, b"the test").success
    finally:
        robot.send_signal(signal.SIGINT)
        told = robot.communicate(timeout=20.0)[1]
    assert robot.returncode == 0
    assert "disarmed -> holding (arm: " in told
    assert "holding -> disarmed (stop: stop asked for by the test" in told
    assert "real-time loop: gc frozen" in told
