"""Flood the bridge with malformed datagrams: nothing moves, the reason is told, a session goes on.

    python tests/adversarial/egm_flood.py --count 1000000

The bridge is a process of its own, the product's command. A controller written by hand keeps a
session with it; between its packets datagrams come that are none, from the controller's own socket
and from others on its machine. Checked are: every answer holds the arm where its session began, to
1e-9 deg, with no speed; never more than one answer to a packet; the reason is on `/yumi/status`
within 2 s of the first such datagram; afterwards the bridge is ready, and answers every packet.
"""

from __future__ import annotations

import argparse
import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))

from egm_controller import HandController
from egm_datagrams import malformed

from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.robot.status import RobotStatus
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.channels import LatestReader
from skewmi.deploy.wire.transport import Link, TransportConfig

CYCLE_S = 0.004032
A_CYCLE = 80
"""Datagrams between two packets."""
SEEDS = 4_000
"""Different datagrams; they are sent again and again, in another order each time."""
TOLD_WITHIN_S = 2.0
READY_WITHIN_S = 5.0


@contextmanager
def bridge() -> Iterator[tuple[tuple[str, int], str]]:
    """The product's bridge; where it listens for a controller, and for sessions."""
    address = ("127.0.0.1", free_port(socket.SOCK_DGRAM))
    locator = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "skewmi.cli.main", "robot", "--backend", "egm", "--json"]
    command += ["--egm-listen", f"{address[0]}:{address[1]}", "--egm-listen-left", "none"]
    command += ["--listen", locator, "--end-with-input"]
    child = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert child.stdin is not None
    assert child.stdout is not None
    try:
        assert child.stdout.readline(), "the bridge did not start"
        yield address, locator
    finally:
        alive = child.poll() is None
        child.stdin.close()
        child.wait(20)
        assert alive, "the bridge has died"
        assert child.returncode == 0, f"the bridge ended with {child.returncode}"


class Flood:
    """A session with a bridge, and datagrams in between.

    Args:
        controller: Connected to the bridge.
        status: What the bridge tells.
        seed: For all choices.
    """

    def __init__(self, controller: HandController, status: LatestReader, seed: int) -> None:
        self.controller = controller
        self._status = status
        self._rng = np.random.default_rng(seed)
        kinds = malformed(self._rng, controller.packet)
        self._datagrams = [next(kinds) for _ in range(SEEDS)]
        self._home = [*controller.packet.axes, *controller.packet.axis_7]
        self._due_s = time.monotonic()
        self.packets = self.answers = self.sent = self.unusable = 0
        self.first_s: float | None = None
        self.told_s: float | None = None
        self.reasons: set[str] = set()

    def cycle(self, strangers: list[socket.socket], count: int) -> int:
        """A packet of the controller, and so many datagrams; how many answers came since the last.

        Raises:
            AssertionError: An answer moves the arm, or there are more answers than packets.
        """
        self.controller.send()
        self.packets += 1
        sockets = [self.controller.socket, *strangers]
        for number in self._rng.integers(SEEDS, size=count).tolist():
            if self.first_s is None:
                self.first_s = time.monotonic()
            sender = sockets[number % len(sockets)]
            sender.sendto(self._datagrams[number], self.controller.bridge)
        self.sent += count
        self._listen()
        self._due_s = max(self._due_s + CYCLE_S, time.monotonic() - 0.02)
        time.sleep(max(0.0, self._due_s - time.monotonic()))
        answers = self.controller.collect()
        for answer in answers:
            off = np.abs(np.array([*answer.axes, *answer.axis_7]) - self._home).max()
            assert off < 1e-9, f"the arm was told to move by {off} deg"
            assert not any((*answer.speeds, *answer.speed_7)), "the arm was told to move"
        self.controller.answers.clear()
        self.answers += len(answers)
        assert self.answers <= self.packets, "more answers than packets"
        return len(answers)

    def _listen(self) -> None:
        for sample in self._status.drain():
            status = RobotStatus.decode(sample.payload)
            if status is None:
                continue
            self.unusable = int(status.told.get("unusable", "0"))
            reason = status.told.get("unusable_reason", "")
            if reason and self.first_s is not None:
                self.told_s = self.told_s or time.monotonic()
                self.reasons.add(reason.split(":")[0])


def run(count: int, seed: int) -> dict[str, Any]:
    """The whole story; what came of it.

    Raises:
        AssertionError: Something of what is promised above is not so.
    """
    with (
        bridge() as (address, locator),
        HandController(address) as controller,
        Link.open(TransportConfig.for_client(locator), "egm_flood") as link,
    ):
        status = link.subscribe(topics.YUMI_STATUS, depth=None)
        flood = Flood(controller, status, seed)
        strangers = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3)]
        _until_ready(flood, link)
        while flood.sent < count:
            flood.cycle(strangers, min(A_CYCLE, count - flood.sent))
        flooded_s = time.monotonic()
        _until_ready(flood, link)
        ready_s = time.monotonic() - flooded_s
        answered = sum(flood.cycle([], 0) for _ in range(250))
        for stranger in strangers:
            stranger.close()
    assert flood.first_s is not None
    assert flood.told_s is not None, "no reason was told"
    told_s = flood.told_s - flood.first_s
    assert told_s < TOLD_WITHIN_S, f"told after {told_s:.2f} s"
    assert answered >= 240, f"{answered} of 250 packets were answered afterwards"
    return {
        "sent": flood.sent,
        "counted_by_the_bridge": flood.unusable,
        "packets": flood.packets,
        "answers": flood.answers,
        "reason_told_after_s": round(told_s, 3),
        "ready_again_after_s": round(ready_s, 3),
        "answered_of_250_afterwards": answered,
        "seed": seed,
    }


def _until_ready(flood: Flood, link: Link) -> None:
    deadline = time.monotonic() + READY_WITHIN_S
    while True:
        for _ in range(50):
            flood.cycle([], 0)
        text = link.call(topics.YUMI_DESCRIBE, 5.0).message
        description = RobotDescription.from_json(text)
        if description.ready:
            assert description.state == "disarmed"
            return
        assert time.monotonic() < deadline, description.not_ready


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20_000, help="datagrams")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    sys.stdout.write(json.dumps(run(arguments.count, arguments.seed), indent=2) + "\n")


if __name__ == "__main__":
    main()
