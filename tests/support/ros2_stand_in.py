"""Runs a node that is written for rclpy where there is no ROS 2: FILE, locator of a robot server.

It has as much of `rclpy` as the examples use. Messages come over Zenoh from who is at the locator,
decoded by rosbags into objects with the fields of the ROS 2 types.
"""

from __future__ import annotations

import runpy
import sys
import time
from collections.abc import Callable
from types import ModuleType
from typing import Any

from skewmi.deploy.wire.ros2_types import store
from skewmi.deploy.wire.topics import Topic
from skewmi.deploy.wire.transport import Link, TransportConfig


class Node:
    """`rclpy.node.Node`."""

    link: Link

    def __init__(self, name: str) -> None:
        self.name = name
        self.subscriptions: list[tuple[Any, str, Callable[[Any], None]]] = []

    def create_subscription(
        self, kind: str, topic: str, callback: Callable[[Any], None], depth: int
    ) -> None:
        source = self.link.subscribe(Topic(topic, kind), depth=depth)
        self.subscriptions.append((source, kind, callback))

    def get_logger(self) -> Node:
        return self

    def info(self, text: str) -> None:
        print(f"[{self.name}]: {text}", flush=True)  # noqa: T201


def spin(node: Node) -> None:
    """Serve the node until the process is ended."""
    while True:
        for source, kind, callback in node.subscriptions:
            for sample in source.drain():
                callback(store().deserialize_cdr(sample.payload, kind))
        time.sleep(0.01)


def install(**modules: dict[str, Any]) -> None:
    """Let modules be imported; a double underscore stands for a dot."""
    for name, content in modules.items():
        dotted = name.replace("__", ".")
        module = ModuleType(dotted)
        module.__dict__.update(content)
        sys.modules[dotted] = module


def main() -> None:
    file, locator = sys.argv[1:]
    install(
        rclpy={"init": lambda: None, "spin": spin},
        rclpy__node={"Node": Node},
        sensor_msgs={},
        sensor_msgs__msg={"JointState": "sensor_msgs/msg/JointState"},
        diagnostic_msgs={},
        diagnostic_msgs__msg={"DiagnosticArray": "diagnostic_msgs/msg/DiagnosticArray"},
    )
    with Link.open(TransportConfig.for_client(locator), "listener") as Node.link:
        runpy.run_path(file, run_name="__main__")


if __name__ == "__main__":
    main()
