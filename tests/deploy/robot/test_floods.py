"""Strangers' messages at a robot server on its link: refused in words, without a trace."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from link_peers import eventually
from robot_servers import LAB, describe

from skewmi.cli.stop import StopCommand, run_stop
from skewmi.deploy.robot.backends import BackendOptions
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.intake import MAX_REQUEST_BYTES
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.robot.run import serve_robot
from skewmi.deploy.robot.status import RobotStatus
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import Link, TransportConfig


@pytest.fixture(scope="module")
def link() -> Iterator[Link]:
    """To a robot server in lock-step in this process."""
    locator = f"tcp/127.0.0.1:{free_port()}"
    stop, ready = threading.Event(), threading.Event()
    config = TransportConfig.for_robot(locator, lock_step=True)
    options = BackendOptions(lock_step=True)
    thread = threading.Thread(
        target=serve_robot, args=("sim", options, config, LAB, stop, lambda _: ready.set())
    )
    thread.start()
    assert ready.wait(60.0)
    try:
        with Link.open(TransportConfig.for_client(locator), "test_floods") as opened:
            opened.wait_for_robot(30.0)
            yield opened
    finally:
        stop.set()
        thread.join(30.0)


EXTRAS = st.one_of(
    st.binary(max_size=MAX_REQUEST_BYTES + 200),
    st.integers().map(lambda number: str(number).encode()),
    st.floats().map(lambda number: json.dumps(number).encode()),
    st.sampled_from(
        [
            b"1e999",
            b"-1",
            b"1" * 500,
            b"[" * 1000,
            b'{"a":' * 200,
            b"[" * 200_000,
            b"NaN",
            "\u0663".encode(),
            b"\xff\xfe",
        ]
    ),
)


@settings(
    deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.sampled_from(topics.SERVICES), EXTRAS)
def test_whatever_a_service_is_asked_it_answers_in_words_and_nothing_is_logged(
    link: Link, caplog: pytest.LogCaptureFixture, service: topics.Service, extra: bytes
) -> None:
    caplog.clear()
    reply = link.call(service, 30.0, extra)
    assert reply.message
    assert "internal error" not in reply.message
    assert [record for record in caplog.records if record.levelno > logging.INFO] == []
    if len(extra) > MAX_REQUEST_BYTES:
        assert not reply.success
        assert f"at most {MAX_REQUEST_BYTES} are read" in reply.message


def test_arming_names_whole_publishers(link: Link) -> None:
    for size in (1, 15, 17, 31, 33, 48):
        reply = link.call(topics.YUMI_ARM, 30.0, bytes(size))
        assert not reply.success
        assert f"got {size} bytes" in reply.message


def test_messages_of_nobody_and_the_reason_of_a_refusal_are_in_the_status(link: Link) -> None:
    status = link.subscribe(topics.YUMI_STATUS, depth=None)
    chunks = link.publisher(topics.YUMI_TRAJECTORY)
    assert link.call(topics.YUMI_STOP, 30.0).success
    assert link.call(topics.YUMI_ARM, 30.0, chunks.gid).success
    chunks.put(b"nonsense")
    told: list[RobotStatus] = []

    def tell() -> int:
        told.extend(s for x in status.drain() if (s := RobotStatus.decode(x.payload)) is not None)
        return len(told)

    eventually(lambda: tell() and told[-1].refused_of_commander, 30.0)
    refused, count = told[-1], len(told)
    assert refused.broken_of_commander == 1
    assert "malformed" in refused.last_refusal
    # A later status, after the first was lost, still knows.
    eventually(lambda: tell() > count, 30.0)
    later = told[-1]
    assert later.refusal == ""
    assert later.last_refusal == refused.last_refusal
    assert link.call(topics.YUMI_STOP, 30.0).success


def test_stop_by_datagrams_while_the_link_is_deaf(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What holds Zenoh up, whatever it is, does not hold up the stop."""
    locator = f"tcp/127.0.0.1:{free_port()}"
    stop, ready = threading.Event(), threading.Event()
    config = TransportConfig.for_robot(locator)
    options = (BackendOptions(), config, LAB, stop, lambda _: ready.set())
    thread = threading.Thread(target=serve_robot, args=("hold", *options))
    thread.start()
    assert ready.wait(60.0)
    try:
        with Link.open(TransportConfig.for_client(locator), "commander") as link:
            link.wait_for_robot(30.0)
            assert link.call(topics.YUMI_ARM, 30.0, bytes(16)).success
            said = RobotDescription.from_json(link.call(topics.YUMI_DESCRIBE, 30.0).message)
            assert said.stop_paths == (locator.replace("tcp", "udp"),)
            monkeypatch.setattr(Link, "open", None)
            started = time.monotonic()
            assert run_stop(StopCommand(connect=locator)) == 0
            assert time.monotonic() - started < 5.0
            monkeypatch.undo()
            assert "stop asked for by skewmi stop (a datagram from 127.0.0.1)" in (
                capsys.readouterr().out
            )
        after = describe(locator)
        assert (after.state, after.stops) == ("disarmed", 1)
    finally:
        stop.set()
        thread.join(30.0)
