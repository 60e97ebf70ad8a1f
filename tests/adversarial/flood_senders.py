"""Programs that send a robot server more than it asked for: `python flood_senders.py KIND LOCATOR`.

Each prints "ready" once it has begun and goes on until it is killed. They are strangers: plain
Zenoh with its own settings, and messages made by hand.
"""

from __future__ import annotations

import itertools
import json
import os
import socket
import struct
import sys
import time
from collections.abc import Callable
from typing import Any

import zenoh

from skewmi.deploy.wire import ros2_keys, stop_path, topics
from skewmi.deploy.wire.messages import encode_trigger_request
from skewmi.robot_models import yumi

LONG = 130_000
"""Bytes; a robot server reads chunks of up to 131,072."""
GID = bytes(range(16))
_HEADER = b"\0\1\0\0" + struct.pack("<iI", 1, 0) + struct.pack("<I", 1) + b"\0\0\0\0"
"""CDR, a stamp, an empty frame."""


def many_names(size: int = LONG) -> bytes:
    """A JointState, or the beginning of a JointTrajectory, with as many empty names as fit."""
    count = (size - 64) // 8
    names = (struct.pack("<I", 1) + b"\0\0\0\0") * count
    return _HEADER + struct.pack("<I", count) + names + struct.pack("<III", 0, 0, 0)


def many_points(size: int = LONG) -> bytes:
    """A JointTrajectory of no joints with as many empty points as fit."""
    count = (size - len(_HEADER) - 8) // 24
    point = struct.pack("<IIIIiI", 0, 0, 0, 0, 0, 0)
    return _HEADER + struct.pack("<II", 0, count) + point * count


def odd_points(count: int = 500) -> bytes:
    """A JointTrajectory that may be read, but only point by point: every other has an effort."""
    data = bytearray(_HEADER[4:])

    def pad(size: int) -> None:
        data.extend(bytes(-len(data) % size))

    names = yumi.joint_names("right")
    data += struct.pack("<I", len(names))
    for name in names:
        text = name.encode() + b"\0"
        pad(4)
        data += struct.pack("<I", len(text)) + text
    pad(4)
    data += struct.pack("<I", count)
    for index in range(count):
        for length in (7, 7, 7, index % 2):
            pad(4)
            data += struct.pack("<I", length)
            if length:
                pad(8)
                data += bytes(8 * length)
        pad(4)
        data += struct.pack("<iI", 0, 0)
    return _HEADER[:4] + bytes(data)


def session(locator: str) -> Any:
    """A client with Zenoh's own settings."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([locator]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def ready() -> None:
    sys.stdout.write("ready\n")
    sys.stdout.flush()


def publish(
    locator: str, topic: topics.Topic, payload: bytes, rate_hz: float | None, *, named: bool = True
) -> None:
    """Send a message again and again; as fast as the link takes it without a rate."""
    block = zenoh.CongestionControl.BLOCK
    client = session(locator)
    publisher = client.declare_publisher(ros2_keys.data_key(0, topic), congestion_control=block)
    time.sleep(0.5)
    ready()
    due_s = time.monotonic()
    for sequence in itertools.count(1):
        attachment = ros2_keys.encode_attachment(sequence, 0, GID) if named else None
        publisher.put(payload, attachment=attachment)
        if rate_hz is not None:
            due_s += 1.0 / rate_hz
            time.sleep(max(0.0, due_s - time.monotonic()))


def call(locator: str, service: topics.Service, extra: bytes) -> None:
    """Call a service without end, and read the answers."""
    client = session(locator)
    key, request = ros2_keys.data_key(0, service), encode_trigger_request(extra)
    ready()
    while True:
        for _ in client.get(key, timeout=2.0, payload=request):
            pass


def ask_and_hang(locator: str, service: topics.Service, extra: bytes) -> None:
    """Call a service many times at once and read nothing."""
    client = session(locator)
    key, request = ros2_keys.data_key(0, service), encode_trigger_request(extra)
    asleep = zenoh.handlers.Callback(lambda reply: time.sleep(60), indirect=False)
    ready()
    while True:
        client.get(key, asleep, timeout=60.0, payload=request)
        time.sleep(0.0005)


def watch(locator: str, count: str) -> None:
    """So many sessions that only read; whoever started this lets it sleep."""
    sessions = [session(locator) for _ in range(int(count))]
    kept = [
        one.declare_subscriber(ros2_keys.data_key(0, topic), zenoh.handlers.RingChannel(1))
        for one in sessions
        for topic in topics.TOPICS
    ]
    time.sleep(0.5)
    ready()
    time.sleep(1e6)
    del kept


def datagrams(locator: str, *, valid: bool) -> None:
    """Stop without end, or nonsense of that length."""
    host, _, port = locator.partition("/")[2].rpartition(":")
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.connect((host, int(port)))
    nonsense = os.urandom(stop_path.MESSAGE_BYTES)
    text = stop_path.request(0, stop=True, number=bytes(16)) if valid else nonsense
    ready()
    while True:
        try:
            sender.send(text)
        except OSError:
            continue


_CHUNKS, _GRIPPER = topics.YUMI_TRAJECTORY, topics.YUMI_GRIPPER

SENDERS: dict[str, Callable[[str], None]] = {
    "gripper, 130 kB at 100 Hz": lambda at: publish(at, _GRIPPER, many_names(), 100.0),
    "gripper, 130 kB at 400 Hz": lambda at: publish(at, _GRIPPER, many_names(), 400.0),
    "gripper, 1 kB at 400 Hz": lambda at: publish(at, _GRIPPER, many_names(1000), 400.0),
    "chunks of 5,400 points at 50 Hz": lambda at: publish(at, _CHUNKS, many_points(), 50.0),
    "chunks of 16,000 names at 50 Hz": lambda at: publish(at, _CHUNKS, many_names(), 50.0),
    "chunks of 500 odd points at 50 Hz": lambda at: publish(at, _CHUNKS, odd_points(), 50.0),
    "chunks, 8 bytes": lambda at: publish(at, _CHUNKS, bytes(8), None),
    "chunks, empty, of nobody": lambda at: publish(at, _CHUNKS, b"", None, named=False),
    "chunks, 60 kB": lambda at: publish(at, _CHUNKS, bytes(60_000), None),
    "gripper, 8 bytes": lambda at: publish(at, _GRIPPER, bytes(8), None),
    "gripper, empty, of nobody": lambda at: publish(at, _GRIPPER, b"", None, named=False),
    "calls of describe": lambda at: call(at, topics.YUMI_DESCRIBE, b"scene"),
    "calls of arm": lambda at: call(at, topics.YUMI_ARM, GID),
    "calls of stop": lambda at: call(at, topics.YUMI_STOP, b""),
    "calls of scene reset": lambda at: call(at, topics.YUMI_SCENE_RESET, b"1"),
    "calls of scene reset, 1e999": lambda at: call(at, topics.YUMI_SCENE_RESET, b"1e999"),
    "calls of scene reset, 200 kB": lambda at: call(at, topics.YUMI_SCENE_RESET, 200_000 * b"["),
    "answers that nobody reads": lambda at: ask_and_hang(at, topics.YUMI_DESCRIBE, b"scene"),
    "datagrams that stop": lambda at: datagrams(at, valid=True),
    "datagrams of nonsense": lambda at: datagrams(at, valid=False),
}
"""Kind of flood -> what brings it about. Chunks come with the commander's id, see `floods`."""


if __name__ == "__main__":
    if sys.argv[1] == "watch":
        watch(*sys.argv[2:])
    SENDERS[sys.argv[1]](sys.argv[2])
