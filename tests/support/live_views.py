"""Deployments with a live view for tests: a policy, a viewer, and what is told of the view."""

from __future__ import annotations

import contextlib
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from scripted_open_press_close import ScriptedOpenPressClose

from skewmi.deploy.replay import viewer
from skewmi.deploy.report import DeployReport
from skewmi.deploy.robot.process import free_port
from skewmi.policy_io import Array
from skewmi.sim.tasks.open_press_close.definition import make_layout

PATIENT_MS = 100.0
"""Lead of runs in real time: what is claimed of them does not need a quick computer."""


class Scripted(ScriptedOpenPressClose):
    """The script for some steps; something happens at one of them."""

    def __init__(self, steps: int = 1000, at_step: int = -1, what: Any = None) -> None:
        super().__init__(make_layout())
        self._steps, self._at_step, self._what = steps, at_step, what

    def reset(self) -> None:
        super().reset()
        self.count = 0

    def act(self, observation: Array) -> Array:
        self.count += 1
        if self.count == self._at_step:
            self._what()
        if self.count > self._steps:
            raise ValueError("enough")
        return super().act(observation)


@contextlib.contextmanager
def gathering_viewer(path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Rerun as a viewer without a screen: takes what comes over gRPC into a file."""
    port = free_port()
    child = subprocess.Popen(
        [viewer.executable(), "--save", path, "--port", str(port), "--bind", "127.0.0.1"],
        stderr=subprocess.DEVNULL,
        # A suite in a script's background is born with SIGINT ignored, and so would this child be.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        deadline = time.monotonic() + 60.0
        while True:
            with contextlib.suppress(OSError):
                socket.create_connection(("127.0.0.1", port), 0.2).close()
                break
            assert time.monotonic() < deadline, "the viewer does not start"
            time.sleep(0.05)
        yield f"rerun+http://127.0.0.1:{port}/proxy", child
    finally:
        child.send_signal(signal.SIGCONT)
        child.kill()
        child.wait()


def about_the_view(report: DeployReport) -> list[str]:
    """Notes of a run but for those that this computer is busy, or that a recorder was behind."""
    others = ("too busy for real time", "the recording lacks")
    return [note for note in report.notes if not any(other in note for other in others)]
