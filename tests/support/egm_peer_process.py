"""An independent EGM client, ABBRobotEGM, in a process of its own.

Its `egm.proto` must not meet ours in one process, and its way of receiving is its own. Run as

    python egm_peer_process.py describe               its message classes, as JSON
    python egm_peer_process.py read                   hexadecimal EgmRobot lines -> JSON lines
    python egm_peer_process.py write                  JSON lines -> hexadecimal EgmSensor lines
    python egm_peer_process.py drive PORT JSON ...    drive arms, one per PORT and JSON

`drive` moves each arm from where it stands to `goal` (degrees, axes 1 to 7) on a smooth ramp of
`seconds`, with speed references if `feed_forward`, and prints what it saw as JSON.
"""

from __future__ import annotations

import json
import math
import sys
import time
from typing import Any

MCI_RUNNING = 3


def tell(what: str) -> None:
    sys.stdout.write(what + "\n")
    sys.stdout.flush()


def describe() -> None:
    from ABBRobotEGM._egm_protobuf import egm_pb2

    messages = {}
    for name, message in egm_pb2.DESCRIPTOR.message_types_by_name.items():
        messages[name] = {
            field.name: [field.number, field.type, bool(field.is_repeated), bool(field.is_required)]
            for field in message.fields
        }
    tell(json.dumps(messages))


def read() -> None:
    from ABBRobotEGM._egm_protobuf import egm_pb2
    from google.protobuf.json_format import MessageToDict
    from google.protobuf.unknown_fields import UnknownFieldSet

    for line in sys.stdin:
        message = egm_pb2.EgmRobot()
        message.ParseFromString(bytes.fromhex(line))
        assert message.IsInitialized()
        assert len(UnknownFieldSet(message)) == 0
        content = MessageToDict(
            message, preserving_proto_field_name=True, use_integers_for_enums=True
        )
        tell(json.dumps(content))


def write() -> None:
    from ABBRobotEGM._egm_protobuf import egm_pb2
    from google.protobuf.json_format import ParseDict

    for line in sys.stdin:
        message = ParseDict(json.loads(line), egm_pb2.EgmSensor())
        tell(message.SerializeToString().hex())


class Driver:
    """Drives one arm."""

    def __init__(self, port: int, goal: list[float], seconds: float, feed_forward: bool) -> None:
        from ABBRobotEGM import EGM

        self.egm = EGM(port=port)
        self.goal, self.seconds, self.feed_forward = goal, seconds, feed_forward
        self.start: list[float] | None = None
        self.guided_at = 0.0
        self.since = 0.0
        self.replies = 0
        self.worst_error = 0.0
        self.last: list[float] = []
        self.states: set[str] = set()

    def serve(self) -> None:
        success, state, _ = self.egm.receive_latest(timeout=0.0)
        if not success:
            return
        measured = [*state.joint_angles, state.external_axes[0]]
        assert len(measured) == 7
        assert state.cartesian is not None
        assert state.cartesian_planned is not None
        assert state.clock is not None
        self.last = measured
        self.states.add(f"{state.motors_on}/{state.rapid_running}/{state.mci_state}")
        # By the controller's clock: on a busy machine an emulated controller is late.
        now = state.clock[0] + state.clock[1] / 1e6
        if self.start is None or state.mci_state != MCI_RUNNING:
            self.start, self.guided_at = measured, now + 0.3
        self.since = now - self.guided_at
        position, speed = self._plan(self.since)
        if self.since > 0.0:
            error = max(abs(a - b) for a, b in zip(measured, position, strict=True))
            self.worst_error = max(self.worst_error, error)
        self.replies += self.egm.send_to_robot(
            position[:6],
            speed_ref=speed[:6] if self.feed_forward else None,
            external_joints=position[6:],
            external_joints_speed=speed[6:] if self.feed_forward else None,
        )

    def _plan(self, t: float) -> tuple[list[float], list[float]]:
        assert self.start is not None
        u = min(max(t / self.seconds, 0.0), 1.0)
        part = 0.5 - 0.5 * math.cos(math.pi * u)
        rate = 0.5 * math.pi / self.seconds * math.sin(math.pi * u)
        pairs = list(zip(self.start, self.goal, strict=True))
        return [a + part * (b - a) for a, b in pairs], [rate * (b - a) for a, b in pairs]


def drive(arguments: list[str]) -> None:
    drivers = [
        Driver(int(port), **json.loads(what))
        for port, what in zip(arguments[::2], arguments[1::2], strict=True)
    ]
    tell("ready")
    deadline = time.monotonic() + 120.0
    while any(driver.since < driver.seconds + 2.0 for driver in drivers):
        assert time.monotonic() < deadline, "the controller does not guide the arms"
        for driver in drivers:
            driver.serve()
        time.sleep(0.0005)
    report: list[dict[str, Any]] = [
        {
            "joints": driver.last,
            "replies": driver.replies,
            "worst_error": driver.worst_error,
            "states": sorted(driver.states),
        }
        for driver in drivers
    ]
    tell(json.dumps(report))


if __name__ == "__main__":
    command, *rest = sys.argv[1:]
    {"describe": describe, "read": read, "write": write}.get(command, lambda: drive(rest))()
