"""A child that a busy computer slows down is waited for; one that hangs is not."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from tempfile import TemporaryFile

import pytest

from skewmi.child_process import ChildProcess

WORKS = "import time; t = time.process_time()\nwhile time.process_time() < t + {0}: pass"
Start = Callable[[str], ChildProcess]


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts a Python program as a child; ends it afterwards."""
    started = []

    def child(program: str) -> ChildProcess:
        process = subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE)
        started.append(process)
        return ChildProcess(process, TemporaryFile())

    yield child
    for process in started:
        process.kill()
        process.communicate()


def test_a_child_that_works_is_waited_for_beyond_the_time_it_may_do_nothing(start: Start) -> None:
    child = start(WORKS.format(3.0) + "\nraise SystemExit(7)")
    assert child.wait(1.0, 300.0) == 7


def test_a_child_that_hangs_is_waited_for_no_longer_than_it_may_do_nothing(start: Start) -> None:
    child = start(WORKS.format(300.0))
    while not child.is_working():
        time.sleep(0.1)
    os.kill(child.process.pid, signal.SIGSTOP)
    began = time.monotonic()
    assert child.wait(0.5, 300.0) is None
    assert not child.is_working()
    assert time.monotonic() - began < 100.0
    assert child.process.poll() is None


def test_a_child_that_works_for_ever_is_waited_for_no_longer_than_allowed(start: Start) -> None:
    assert start(WORKS.format(300.0)).wait(0.5, 1.0) is None


def test_of_a_child_that_is_gone_nothing_is_asked(start: Start) -> None:
    child = start("")
    assert child.wait(60.0, 60.0) == 0
    assert not child.is_working()
