"""Bring the arm smoothly to rest and disarm it. Anybody may; it needs no arming.

In fault it acknowledges the fault once the arm rests. The robot server is asked by datagrams first,
where it takes them, as these reach it however busy its link is; docs/security.md says where.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass
from pathlib import Path

from skewmi.cli import numbers
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.wire import stop_path, topics
from skewmi.deploy.wire.domain import ros_domain
from skewmi.deploy.wire.stop_path import StopAnswer
from skewmi.deploy.wire.transport import Link, TransportConfig

MAX_TIMEOUT_S = 3600.0

_DATAGRAMS_S = 0.5
"""How long datagrams are tried before the link."""
_OVER = ("disarmed", "fault")


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
    deadline = time.monotonic() + options.timeout_s
    answer = _stop_by_datagrams(config, deadline)
    if answer is None or answer.state == "fault":
        # Datagrams tell nobody's name, and acknowledge no fault.
        answer = _stop_by_link(config, options.timeout_s, deadline)
    if options.json:
        print(json.dumps({"state": answer.state, "reason": answer.reason}))
    else:
        print(f"{answer.state}: {answer.reason}")
    return 0 if answer.state == "disarmed" else 1


def _stop_by_datagrams(config: TransportConfig, deadline: float) -> StopAnswer | None:
    """Stop, and wait for rest; what the robot server said last, None if it says nothing."""
    answer = stop_path.ask(config, stop=True, timeout_s=_DATAGRAMS_S)
    while answer is not None and answer.state not in _OVER and time.monotonic() < deadline:
        time.sleep(0.02)
        told = stop_path.ask(config, stop=False, timeout_s=_DATAGRAMS_S)
        if told is None:
            break
        answer = told
    return answer


def _stop_by_link(config: TransportConfig, timeout_s: float, deadline: float) -> StopAnswer:
    """The same by the link; a fault is acknowledged."""
    with Link.open(config, f"skewmi_stop_{os.getpid()}") as link:
        link.call(topics.YUMI_STOP, timeout_s, b"skewmi stop")
        while True:
            answer = link.call(topics.YUMI_DESCRIBE, timeout_s)
            description = RobotDescription.from_json(answer.message)
            if description.state == "disarmed" or time.monotonic() > deadline:
                return StopAnswer(description.state, description.reason)
            time.sleep(0.02)
            if description.state == "fault":
                # It is acknowledged once the arm rests, not before.
                link.call(topics.YUMI_STOP, timeout_s, b"skewmi stop")
