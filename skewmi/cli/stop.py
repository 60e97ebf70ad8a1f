"""Bring the arm smoothly to rest and disarm it. Anybody may; it needs no arming.

In fault it acknowledges the fault once the arm rests.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass
from pathlib import Path

from skewmi.cli import numbers
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.domain import ros_domain
from skewmi.deploy.wire.transport import Link, TransportConfig

MAX_TIMEOUT_S = 3600.0


@dataclass(frozen=True)
class StopCommand:
    """Options of `skewmi stop`."""

    connect: str | None = None
    """Zenoh locator of the robot server; by default what --zenoh-config says, else
    tcp/127.0.0.1:7447."""
    domain: int | None = None
    """ROS 2 domain, 0..232; by default ROS_DOMAIN_ID, else 0."""
    timeout_s: float = 5.0
    """How long to wait for the arm to rest, s."""
    zenoh_config: Path | None = None
    """Zenoh configuration file (JSON5 or YAML), such as `skewmi certificates` makes."""
    json: bool = False
    """Print the robot server's state as one JSON document."""


def run_stop(options: StopCommand) -> int:
    """Stop the arm. Returns 0 if it rests disarmed, 1 if not in time or in fault."""
    numbers.require("--timeout-s", options.timeout_s, 0.01, MAX_TIMEOUT_S)
    config = TransportConfig.for_client(
        options.connect, domain=ros_domain(options.domain), zenoh_config=options.zenoh_config
    )
    with Link.open(config, f"skewmi_stop_{os.getpid()}") as link:
        deadline = time.monotonic() + options.timeout_s
        link.call(topics.YUMI_STOP, options.timeout_s, b"skewmi stop")
        while True:
            answer = link.call(topics.YUMI_DESCRIBE, options.timeout_s)
            description = RobotDescription.from_json(answer.message)
            if description.state == "disarmed" or time.monotonic() > deadline:
                break
            time.sleep(0.02)
            if description.state == "fault":
                # It is acknowledged once the arm rests, not before.
                link.call(topics.YUMI_STOP, options.timeout_s, b"skewmi stop")
    if options.json:
        print(json.dumps({"state": description.state, "reason": description.reason}))
    else:
        print(f"{description.state}: {description.reason}")
    return 0 if description.state == "disarmed" else 1
