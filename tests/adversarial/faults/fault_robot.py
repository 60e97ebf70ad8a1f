"""`skewmi robot` as a child process that writes down every target it gives to its servos.

Run as a script it is the child: the product's own command with a robot that logs. `Robot` is the
parent's handle.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Self

import numpy as np

from skewmi.cli.main import main
from skewmi.deploy.robot.backends.mujoco import backend as mujoco_backend
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.robot.process import free_port
from skewmi.policy_io import Array

LOG_VARIABLE = "SKEWMI_FAULTS_LOG"
STEP, RESET, TAKEN = 0.0, 1.0, 2.0
"""Kinds of rows: a target; the arm is put elsewhere at rest; it is taken away in motion."""
ROW = 1 + 1 + 7 + 7
"""Columns of a row: kind, monotonic s, commanded q (7,), measured q (7,); rad."""


class WatchedSimulation(ArmSimulation):
    """It, and a row in a file for every target; no buffer, so that kill -9 loses none."""

    def __init__(self, *args: Any, **options: Any) -> None:
        self._log = os.open(os.environ[LOG_VARIABLE], os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        super().__init__(*args, **options)

    def step(self) -> None:
        super().step()
        self._write(STEP, self.command.q)

    def reset(self, seed: int) -> Array:
        q = super().reset(seed)
        self._write(RESET, q)
        return q

    def _write(self, kind: float, commanded: Array) -> None:
        measured = self._data.qpos[self.scene.arm_qpos]
        row = np.concatenate([[kind, time.monotonic()], commanded, measured])
        os.write(self._log, row.astype("<f8").tobytes())


class Robot:
    """A watched robot server process; a context manager that ends it.

    Args:
        log: File for the rows; kept over restarts.
        lock_step: Its pace.
        environment: Added to the child's.
    """

    def __init__(
        self, log: Path, *, lock_step: bool, environment: dict[str, str] | None = None
    ) -> None:
        self.log = log
        self.lock_step = lock_step
        self.locator = f"tcp/127.0.0.1:{free_port()}"
        self._environment = {**os.environ, LOG_VARIABLE: str(log), **(environment or {})}
        self._child: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start and wait until it serves."""
        command = [sys.executable, __file__, "robot", "--listen", self.locator, "--json"]
        command += ["--end-with-input", *(["--lock-step"] if self.lock_step else [])]
        self._child = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=self._environment,
        )
        assert self._child.stdout is not None
        assert self._child.stdout.readline(), "the robot server did not start"

    def end(self, number: int = signal.SIGTERM) -> int:
        """Send a signal and wait; the exit code."""
        assert self._child is not None
        self._child.send_signal(number)
        code = self._child.wait(10.0)
        for pipe in (self._child.stdin, self._child.stdout):
            if pipe is not None:
                pipe.close()
        self._child = None
        return code

    def rows(self) -> Array:
        """Everything written so far. Shape (n, ROW)."""
        content = self.log.read_bytes() if self.log.exists() else b""
        whole = len(content) // (8 * ROW)
        return np.frombuffer(content, "<f8", whole * ROW).reshape(whole, ROW)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._child is not None:
            self._child.kill()
            self.end(signal.SIGKILL)


if __name__ == "__main__":
    mujoco_backend.ArmSimulation = WatchedSimulation  # type: ignore[misc]
    sys.exit(main(sys.argv[1:]))
