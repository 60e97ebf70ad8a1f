"""What a robot server logs: from a thread of its own, bounded, in lines."""

from __future__ import annotations

import logging
import threading
import time

import pytest
from link_peers import eventually

from skewmi.deploy.robot.log import QUEUED, told_from_a_thread

LOG = logging.getLogger("skewmi.deploy.somewhere")


def test_lines_are_told_by_another_thread() -> None:
    told: list[tuple[int, str]] = []
    with told_from_a_thread(lambda line: told.append((threading.get_ident(), line))):
        LOG.info("one %s", "thing")
    ((thread, line),) = told
    assert line == "one thing"
    assert thread != threading.get_ident()


def test_an_error_is_one_line_without_a_traceback() -> None:
    told: list[str] = []
    with told_from_a_thread(told.append):
        try:
            raise RecursionError("too\ndeep")
        except RecursionError:
            LOG.exception("cannot read this")
    (line,) = told
    assert "Traceback" not in line
    assert "\n" not in line
    assert line.startswith("cannot read this: RecursionError")


def test_who_logs_never_waits_and_what_is_too_much_is_counted() -> None:
    told: list[str] = []
    may_go_on = threading.Event()

    def slow(line: str) -> None:
        may_go_on.wait(20.0)
        told.append(line)

    with told_from_a_thread(slow) as handler:
        LOG.info("first")
        eventually(lambda: handler.queue.empty())
        started = time.monotonic()
        for number in range(10 * QUEUED):
            LOG.info("line %d", number)
        assert time.monotonic() - started < 5.0
        assert handler.dropped == 9 * QUEUED
        may_go_on.set()
    assert f"{9 * QUEUED} lines were not told: there were too many at once" in told
    assert len(told) == QUEUED + 2


def test_nobody_else_is_told(capfd: pytest.CaptureFixture[str]) -> None:
    seen: list[logging.LogRecord] = []

    class Everything(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            seen.append(record)

    root, handler = logging.getLogger(), Everything()
    root.addHandler(handler)
    try:
        with told_from_a_thread(lambda line: None):
            LOG.error("for the queue alone")
        assert seen == []
        LOG.error("as before")
        assert len(seen) == 1
    finally:
        root.removeHandler(handler)
    assert "for the queue" not in capfd.readouterr().err
