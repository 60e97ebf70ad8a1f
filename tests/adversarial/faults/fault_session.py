"""The session as a process of its own, which can be told to misbehave.

Run as a script it is the child: it executes one `run_deploy` after another as told on its standard
input, one JSON object a line. `SessionProcess` is the parent's handle.
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any
from unittest.mock import patch

import numpy as np
from fault_plants import PLANTS, Planted

from skewmi.deploy.options import DeployOptions
from skewmi.deploy.run import run_deploy
from skewmi.policy_io import Array
from skewmi.sim.tasks.open_press_close.definition import make_layout

SEED = 33
"""Of a long start motion: 0.3 s."""
Y_TURN = 0.11
"""Where the sweep turns back, m."""


class Sweep:
    """A policy that keeps the hand moving above the box, to and fro, at full speed.

    Args:
        steps: After as many it asks for the end of the run.
        end: How.
        planted: What goes wrong when it is asked.
    """

    def __init__(self, steps: int, end: Callable[[], None], planted: Planted) -> None:
        self.layout = make_layout()
        self._steps, self._end, self._planted = steps, end, planted

    def reset(self) -> None:
        self._count, self._direction = 0, 1.0

    def act(self, observation: Array) -> Array:
        self._count += 1
        if self._count >= self._steps:
            self._end()
        self._planted.act()
        y = observation[self.layout.observation_names.index("hand_y")]
        if abs(y) > Y_TURN and self._direction * y > 0:
            self._direction = -self._direction
        return np.array([0.0, self._direction, 1.0])


def say(**content: Any) -> None:
    """A line to the parent."""
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()


def run(order: dict[str, Any], stop: threading.Event, trigger: threading.Event) -> dict[str, Any]:
    """One run as ordered; its report."""

    def began() -> None:
        say(began=time.monotonic())
        if order["stop_with_plant"]:
            stop.set()

    planted = PLANTS[order["plant"]](trigger, began)
    options = DeployOptions(
        connect=order["locator"],
        lock_step=order["lock_step"],
        seed=SEED,
        start_spread=order["spread"],
        lead_ms=order["lead_ms"],
    )
    with ExitStack() as stack:
        for target, name, replacement in planted.patches():
            stack.enter_context(patch.object(target, name, replacement))
        report = run_deploy(Sweep(order["steps"], stop.set, planted), options, stop=stop)
    return report.as_dict()


def main() -> None:
    """Execute orders until standard input ends."""
    stop, trigger = threading.Event(), threading.Event()
    orders: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            order = json.loads(line)
            if order["do"] == "run":
                orders.put(order)
            else:
                {"stop": stop, "fault": trigger}[order["do"]].set()
        orders.put(None)

    threading.Thread(target=read, daemon=True).start()
    say(ready=True)
    while (order := orders.get()) is not None:
        stop.clear()
        trigger.clear()
        say(report=run(order, stop, trigger))


class SessionProcess:
    """Handle of the child.

    Args:
        environment: Added to the child's.
    """

    def __init__(self, environment: dict[str, str] | None = None) -> None:
        self._environment = {**os.environ, **(environment or {})}
        self._child: subprocess.Popen[str] | None = None

    def start(self) -> None:
        """Start it, or do nothing if it is there."""
        if self._child is not None:
            return
        self._child = subprocess.Popen(
            [sys.executable, __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=self._environment,
        )
        assert self._child.stdout is not None
        assert json.loads(self._child.stdout.readline())["ready"]

    def run(
        self,
        locator: str,
        *,
        lock_step: bool,
        steps: int,
        spread: float,
        lead_ms: float,
        plant: str = "nothing",
        stop_with_plant: bool = False,
        began: Callable[[float], None] = lambda time_s: None,
    ) -> dict[str, Any] | None:
        """One run; its report, or None if the process was killed meanwhile."""
        self.start()
        assert self._child is not None
        assert self._child.stdout is not None
        self.tell(
            do="run",
            locator=locator,
            lock_step=lock_step,
            steps=steps,
            spread=spread,
            lead_ms=lead_ms,
            plant=plant,
            stop_with_plant=stop_with_plant,
        )
        for line in self._child.stdout:
            said = json.loads(line)
            if "began" in said:
                began(said["began"])
            else:
                return dict(said["report"])
        self.close()
        return None

    def tell(self, **order: Any) -> None:
        """`do="stop"` is Ctrl-C; `do="fault"` lets what is planted happen."""
        assert self._child is not None
        assert self._child.stdin is not None
        self._child.stdin.write(json.dumps(order) + "\n")
        self._child.stdin.flush()

    def kill(self) -> None:
        """kill -9."""
        assert self._child is not None
        self._child.kill()

    def close(self) -> None:
        """End it, if it is there."""
        if self._child is None:
            return
        child, self._child = self._child, None
        assert child.stdin is not None
        assert child.stdout is not None
        try:
            child.stdin.close()
            child.wait(10.0)
        except (subprocess.TimeoutExpired, BrokenPipeError):
            child.kill()
            child.wait()
        child.stdout.close()


if __name__ == "__main__":
    main()
