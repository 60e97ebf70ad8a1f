"""The process of `ros2_peer` in the hands of a test, and messages for it to send."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from secured_link import robot_process

from skewmi.deploy.robot.process import free_port

TRAJECTORY, STATE = "trajectory_msgs/msg/JointTrajectory", "sensor_msgs/msg/JointState"
CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
DIAGNOSTICS, TRIGGER = "diagnostic_msgs/msg/DiagnosticArray", "std_srvs/srv/Trigger"
COMMANDS = "/yumi/right/joint_trajectory"
GRID_NS = 4_000_000

Message = dict[str, Any]


class Peer:
    """The other process."""

    def __init__(self, port: int) -> None:
        # Nothing of the surroundings decides which domain or router it uses.
        env = {
            k: v for k, v in os.environ.items() if not k.startswith(("ROS_", "ZENOH_", "PYTHON"))
        }
        # Its trajectories are larger than one of Zenoh's batches of 64 KiB. By default two are
        # queued, and what does not fit is dropped: on a busy computer 7 of 471 such messages.
        env["ZENOH_CONFIG_OVERRIDE"] = "transport/link/tx/queue/size/data=16"
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("ros2_peer.py")), str(port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=env,
        )
        self._subscribed: set[str] = set()

    def ask(self, what: str, **details: Any) -> Any:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"do": what, **details}) + "\n")
        self._process.stdin.flush()
        answer = json.loads(self._process.stdout.readline())
        assert not (isinstance(answer, dict) and "error" in answer), answer
        return answer

    def subscribe(self, topic: str, type_name: str) -> str:
        """Once; the type hash as the peer computes it."""
        self._subscribed.add(topic)
        return str(self.ask("subscribe", topic=topic, type_name=type_name)["hash"])

    def describe(self) -> Message:
        return dict(json.loads(self.ask("call", service="/yumi/describe")["message"]))

    def call(self, service: str) -> tuple[bool, str]:
        reply = self.ask("call", service=service)
        return reply["success"], reply["message"]

    def statuses(self) -> list[dict[str, str]]:
        """What the robot has said of itself since the last call."""
        entries = [
            taken["message"]["status"][0] for taken in self.ask("take", topic="/yumi/status")
        ]
        return [
            {pair["key"]: pair["value"] for pair in entry["values"]} | {"level": entry["level"]}
            for entry in entries
            if entry["name"] == "skewmi_robot"
        ]

    def position(self) -> np.ndarray:
        """Measured positions, newest: seven joints (rad), finger (m)."""
        taken = eventually(lambda: self.ask("take", topic="/yumi/joint_states"))
        return np.array(taken[-1]["message"]["position"])

    def close(self) -> None:
        self._process.kill()
        self._process.wait()


@contextlib.contextmanager
def robot_and_peer() -> Iterator[tuple[str, Peer]]:
    """`skewmi robot` as a user starts it, and the peer that has met it: its locator, the peer."""
    port = free_port()
    locator = f"tcp/127.0.0.1:{port}"
    with robot_process("--backend", "sim", "--listen", locator):
        peer = Peer(port)
        try:
            yield locator, peer
        finally:
            peer.close()


def eventually(condition: Callable[[], Any], timeout_s: float = 60.0) -> Any:
    deadline = time.monotonic() + timeout_s
    while not (value := condition()):
        assert time.monotonic() < deadline, "never became true"
        time.sleep(0.02)
    return value


def trajectory(
    server: Message, change: np.ndarray, duration_s: float = 1.0, ahead_ns: int = 400_000_000
) -> Message:
    """A JointTrajectory from where the arm rests to rest `change` rad away.

    Fifth order in time, s = 10 t^3 - 15 t^4 + 6 t^5: velocity and acceleration vanish at both
    ends, the jerk is at most 60 / duration^3.
    """
    n = round(duration_s * 1e9 / GRID_NS)
    t = np.linspace(0.0, 1.0, n + 1)[:, None]
    position = t**3 * (10.0 - 15.0 * t + 6.0 * t * t)
    velocity = 30.0 * t * t * (1.0 - t) ** 2 / duration_s
    acceleration = 60.0 * t * (1.0 - t) * (1.0 - 2.0 * t) / duration_s**2
    q = np.array(server["commanded_position"]) + position * change
    v, a = velocity * change, acceleration * change
    points = [
        {
            "positions": q[k].tolist(),
            "velocities": v[k].tolist(),
            "accelerations": a[k].tolist(),
            "effort": [],
            "time_from_start": duration(k * GRID_NS),
        }
        for k in range(n + 1)
    ]
    return {
        "header": header(server["clock_ns"] + ahead_ns),
        "joint_names": list(server["joint_names"]),
        "points": points,
    }


def duration(ns: int) -> Message:
    return {"sec": ns // 10**9, "nanosec": ns % 10**9}


def header(stamp_ns: int) -> Message:
    return {"stamp": duration(stamp_ns), "frame_id": "base"}
