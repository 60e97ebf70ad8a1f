"""The emulator and our packets against an independent client, ABBRobotEGM, in its own process."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import math
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from egm_ports import free_udp_port
from egm_wire import Reference

from skewmi.deploy.robot.backends.egm import messages
from skewmi.deploy.robot.backends.egm.codec import (
    decode_reference,
    encode_feedback,
    encode_reference,
)
from skewmi.deploy.robot.backends.egm.packets import FeedbackPacket, Mci, Motors, Pose, Rapid
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.egm_emulator.controller import EmulatedController, IdealPlant
from skewmi.deploy.robot.egm_emulator.emulated_arm import ArmOptions, EmulatedArm
from skewmi.deploy.robot.egm_emulator.pace import RealTimePace
from skewmi.deploy.robot.egm_emulator.wires import NetworkOptions, Wires
from skewmi.robot_models import yumi
from skewmi.robot_models.yumi import ARMS, Side

SUPPORT = Path(__file__).parents[3] / "support"
PEER_VARIABLE = "SKEWMI_EGM_PEER_PYTHON"
"""A Python that has ABBRobotEGM, if ours shall not have it."""

HAS_PEER = PEER_VARIABLE in os.environ or importlib.util.find_spec("ABBRobotEGM") is not None
PYTHON = os.environ.get(PEER_VARIABLE, sys.executable)
PROGRAM = [PYTHON, str(SUPPORT / "egm_peer_process.py")]

pytestmark = pytest.mark.skipif(
    not HAS_PEER,
    reason="the independent client is not installed: pip install -e '.[dev]', or set "
    f"{PEER_VARIABLE} to a Python that has ABBRobotEGM",
)


def ask(command: str, lines: list[str]) -> list[str]:
    result = subprocess.run(
        [*PROGRAM, command], input="\n".join(lines), capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.splitlines()


def test_every_field_is_the_peers() -> None:
    theirs = json.loads(ask("describe", [])[0])
    for name, kind in messages.CLASSES.items():
        ours = {
            field.name: [field.number, field.type, bool(field.is_repeated), bool(field.is_required)]
            for field in kind.DESCRIPTOR.fields
        }
        assert ours == theirs[name], name


def test_the_peer_reads_what_we_write() -> None:
    rng = np.random.default_rng(4)
    packets, lines = [], []
    for number in range(200):
        pose = Pose(rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 4))
        packet = FeedbackPacket(
            sequence=int(rng.integers(2**32)),
            q=rng.uniform(-3, 3, 7),
            motors=Motors(number % 3),
            mci=Mci(number % 4),
            rapid=Rapid((number + 1) % 3),
            clock_us=int(rng.integers(2**50)),
            time_ms=int(rng.integers(2**32)),
            planned_q=rng.uniform(-3, 3, 7),
            converged=bool(number % 2),
            utilization=float(rng.uniform(0, 300)),
            flange=pose,
            planned_flange=pose,
            robotware=6 + number % 2,
            move_index=number,
        )
        packets.append(packet)
        lines.append(encode_feedback(packet).hex())
    for packet, line in zip(packets, ask("read", lines), strict=True):
        assert json.loads(line) == expected(packet)


def expected(packet: FeedbackPacket) -> dict[str, Any]:
    """The packet as the peer's classes show it; 64-bit integers are strings in their JSON."""
    assert packet.clock_us is not None
    assert packet.planned_q is not None
    assert packet.flange is not None
    sec, usec = divmod(packet.clock_us, 1_000_000)
    x, y, z = (1e3 * packet.flange.position).tolist()
    u0, u1, u2, u3 = packet.flange.quaternion_wxyz.tolist()
    robotware_7 = packet.robotware == 7

    def part(q: np.ndarray) -> dict[str, Any]:
        one, two, seven, three, four, five, six = np.degrees(q).tolist()
        content = {
            "joints": {"joints": [one, two, three, four, five, six]},
            "cartesian": {
                "pos": {"x": x, "y": y, "z": z},
                "orient": {"u0": u0, "u1": u1, "u2": u2, "u3": u3},
            },
            "externalJoints": {"joints": [seven, 0.0, 0.0, 0.0, 0.0, 0.0]},
            "time": {"sec": str(sec), "usec": str(usec)},
        }
        if robotware_7:
            content["timeStamp"] = {"sec": str(sec), "nsec": str(1000 * usec)}
        return content

    content: dict[str, Any] = {
        "header": {"seqno": packet.sequence, "tm": packet.time_ms, "mtype": 2},
        "feedBack": part(packet.q),
        "planned": part(packet.planned_q),
        "motorState": {"state": packet.motors.value},
        "mciState": {"state": packet.mci.value},
        "mciConvergenceMet": packet.converged,
        "rapidExecState": {"state": packet.rapid.value},
        "utilizationRate": packet.utilization,
    }
    if robotware_7:
        content |= {
            "moveIndex": packet.move_index,
            "measuredForce": {"fcActive": False},
            "CollisionInfo": {"collsionTriggered": False},
            "RAPIDfromRobot": {"digVal": False},
        }
    return content


def test_we_read_what_the_peer_writes() -> None:
    rng = np.random.default_rng(5)
    angles = rng.uniform(-150, 150, (50, 14)).tolist()
    lines = [
        json.dumps(
            {
                "header": {"seqno": number, "tm": 3, "mtype": 3},
                "planned": {"joints": {"joints": a[:6]}, "externalJoints": {"joints": [a[6]]}},
                "speedRef": {"joints": {"joints": a[7:13]}, "externalJoints": {"joints": [a[13]]}},
            }
        )
        for number, a in enumerate(angles)
    ]
    order = [0, 1, 6, 2, 3, 4, 5]
    for number, (a, line) in enumerate(zip(angles, ask("write", lines), strict=True)):
        packet = decode_reference(bytes.fromhex(line))
        assert packet.v is not None
        assert packet.sequence == number
        np.testing.assert_allclose(np.degrees(packet.q), np.array(a[:7])[order], atol=1e-12)
        np.testing.assert_allclose(np.degrees(packet.v), np.array(a[7:])[order], atol=1e-12)
        # The same message written by us: field by field what the peer wrote, on the wire.
        ours, theirs = (
            Reference.decode(data) for data in (encode_reference(packet), bytes.fromhex(line))
        )
        for field in dataclasses.fields(Reference):
            written = getattr(ours, field.name)
            assert written == pytest.approx(getattr(theirs, field.name), abs=1e-12), field.name


@pytest.mark.parametrize("robotware", [6, 7])
def test_the_peer_drives_both_arms(robotware: int) -> None:
    """One arm with speed references, the other without: it then stays behind by speed / gain."""
    ports: dict[Side, int] = {side: free_udp_port() for side in ARMS}
    settings = ProgramSettings(gain=5.0, comm_timeout_s=1.0)
    homes = {side: np.array(yumi.HOME[side]) for side in ARMS}
    arms = {
        side: EmulatedArm(ArmOptions(side, settings, lag_s=0.010, robotware=robotware), homes[side])
        for side in ARMS
    }
    goals = {"right": [10, -110, 40, 15, 50, -20, -120], "left": [-10, -110, 20, -15, 30, 20, 125]}
    tasks = [
        str(word)
        for side in ARMS
        for word in (
            ports[side],
            json.dumps({"goal": goals[side], "seconds": 2.0, "feed_forward": side == "right"}),
        )
    ]
    peer = subprocess.Popen([*PROGRAM, "drive", *tasks], stdout=subprocess.PIPE, text=True)
    assert peer.stdout is not None
    assert peer.stdout.readline() == "ready\n"
    wires = {side: Wires.open(("127.0.0.1", ports[side]), NetworkOptions()) for side in ARMS}
    controller = EmulatedController(arms, wires, IdealPlant(homes))
    controller.start()
    ended = threading.Event()
    pace = RealTimePace(4_032_000)
    thread = threading.Thread(target=pace.run, args=(controller, lambda: not ended.is_set()))
    thread.start()
    try:
        report = json.loads(peer.stdout.read())
        assert peer.wait(10) == 0
    finally:
        ended.set()
        thread.join()
        controller.close()
    for side, seen in zip(ARMS, report, strict=True):
        np.testing.assert_allclose(seen["joints"], goals[side], atol=0.1)
        assert "True/True/3" in seen["states"]
        assert seen["replies"] > 200
        assert arms[side].errors == []
    # The farthest axis goes 20 deg in 2 s, at most pi/2 times the mean speed: without speed
    # references it stays behind by a fifth of a second of that.
    right, left = (seen["worst_error"] for seen in report)
    assert left > 0.9 * 0.5 * math.pi * (20.0 / 2.0) / 5.0
    assert right < left / 2
