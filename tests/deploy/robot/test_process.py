"""A simulated robot as a child process."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Iterator

import pytest

from skewmi.deploy.robot import process as robot_process
from skewmi.deploy.robot.process import spawn_robot


def test_an_interrupt_while_the_robot_starts_leaves_no_timer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Interrupted:
        closed = False

        def __iter__(self) -> Iterator[bytes]:
            raise KeyboardInterrupt

        def close(self) -> None:
            self.closed = True

    children = []

    class Child(subprocess.Popen):
        def __init__(self, *arguments, **options) -> None:
            super().__init__(*arguments, **options)
            self.stdout.close()
            self.stdout = Interrupted()
            children.append(self)

    monkeypatch.setattr(robot_process.subprocess, "Popen", Child)
    with (
        pytest.raises(KeyboardInterrupt),
        spawn_robot("sim", "open_press_close", "lab", lock_step=True),
    ):
        pass
    assert children[0].poll() is not None
    timers = [t for t in threading.enumerate() if isinstance(t, threading.Timer)]
    assert all(timer.daemon for timer in timers)
    assert all(timer.finished.is_set() for timer in timers)
