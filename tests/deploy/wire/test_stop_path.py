"""Stopping by datagrams: where there is such a path, what it does, and what it does not."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.robot.process import free_port
from skewmi.deploy.wire import stop_path
from skewmi.deploy.wire.stop_path import MESSAGE_BYTES, StopAnswer, StopListener, ask
from skewmi.deploy.wire.transport_config import TransportConfig


class Served:
    """A robot server's end on a free port."""

    def __init__(self, host: str = "127.0.0.1", domain: int = 0) -> None:
        self.port = free_port()
        self.locator = f"tcp/{host}:{self.port}"
        self.stops: list[str] = []
        self.reason = "stop asked for"
        config = TransportConfig.for_robot(self.locator, domain=domain)
        self.listener = StopListener.open(
            config, self.stops.append, lambda: StopAnswer("stopping", self.reason)
        )

    @contextmanager
    def polled(self) -> Iterator[None]:
        """As by a robot server's loop."""
        ended = threading.Event()

        def loop() -> None:
            while not ended.wait(0.002):
                self.listener.poll()

        thread = threading.Thread(target=loop)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()


@pytest.fixture
def served() -> Iterator[Served]:
    made = Served()
    yield made
    made.listener.close()


def send(served: Served, *messages: bytes) -> socket.socket:
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.connect(("127.0.0.1", served.port))
    for message in messages:
        sender.send(message)
    return sender


def test_who_asks_to_stop_is_heard_and_answered(served: Served) -> None:
    config = TransportConfig.for_client(served.locator)
    with served.polled():
        assert ask(config, stop=True, timeout_s=10.0) == StopAnswer("stopping", "stop asked for")
    assert served.stops[0] == "skewmi stop (a datagram from 127.0.0.1)"
    assert served.listener.where == (f"udp/127.0.0.1:{served.port}",)


def test_who_only_asks_stops_nothing(served: Served) -> None:
    config = TransportConfig.for_client(served.locator)
    with served.polled():
        answer = ask(config, stop=False, timeout_s=10.0)
    assert answer is not None
    assert served.stops == []


def test_robots_of_other_domains_do_not_feel_addressed(served: Served) -> None:
    config = TransportConfig.for_client(served.locator, domain=7)
    with served.polled():
        assert ask(config, stop=True, timeout_s=0.1) is None
    assert served.stops == []


def test_nobody_there_is_noticed_at_once() -> None:
    config = TransportConfig.for_client(f"tcp/127.0.0.1:{free_port()}")
    started = time.monotonic()
    assert ask(config, stop=True, timeout_s=10.0) is None
    assert time.monotonic() - started < 5.0


@settings(deadline=None, max_examples=200)
@given(
    st.binary(max_size=2 * MESSAGE_BYTES)
    | st.binary(max_size=40).map(
        lambda tail: stop_path.request(0, stop=True, number=bytes(16))[:-1] + tail
    )
)
def test_nonsense_stops_nothing_and_is_not_answered(message: bytes) -> None:
    served = NONSENSE
    with send(served, message) as sender:
        heard = served.listener.poll()
        right = message[: len(REQUEST) - 1] == REQUEST[:-1] and len(message) == MESSAGE_BYTES
        assert heard == int(right)
        sender.settimeout(0.0)
        if not right:
            with pytest.raises(BlockingIOError):
                sender.recv(1)


REQUEST = stop_path.request(0, stop=True, number=bytes(16))
NONSENSE = Served()


def test_one_look_takes_and_answers_a_bounded_number_and_stops_once(served: Served) -> None:
    with send(served, *(100 * [REQUEST])) as sender:
        deadline = time.monotonic() + 5.0
        while not (heard := served.listener.poll()):
            assert time.monotonic() < deadline
        assert 0 < heard <= stop_path.MOST_TAKEN
        assert len(served.stops) == 1
        sender.settimeout(0.0)
        answers = 0
        with suppress(BlockingIOError):
            while sender.recv(2 * MESSAGE_BYTES):
                answers += 1
        assert 1 <= answers <= stop_path.MOST_ANSWERED


@pytest.mark.parametrize("reason", ["", "a" * 10_000, "\x00\x1b" * 3000, "\U0001f916" * 400])
def test_an_answer_is_no_longer_than_the_request(served: Served, reason: str) -> None:
    served.reason = reason
    with send(served, REQUEST) as sender:
        served.listener.poll()
        sender.settimeout(5.0)
        answer = sender.recv(10 * MESSAGE_BYTES)
        assert len(answer) <= len(REQUEST)
    with served.polled():
        said = ask(TransportConfig.for_client(served.locator), stop=False, timeout_s=10.0)
    assert said is not None
    assert reason.startswith(said.reason)


def test_answers_of_others_are_not_believed(served: Served) -> None:
    """Who does not see the request does not know its number."""
    with served.polled(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(stop_path.secrets, "token_bytes", lambda count: b"n" * count)
        real = stop_path._asked
        patch.setattr(
            stop_path, "_asked", lambda one, message, number: real(one, message, b"m" * 16)
        )
        assert ask(TransportConfig.for_client(served.locator), stop=False, timeout_s=0.1) is None


@pytest.mark.parametrize(
    ("locator", "hosts"),
    [
        ("tcp/127.0.0.1:7447", ["127.0.0.1"]),
        ("tcp/[::1]:7447", ["::1"]),
        ("tcp/0.0.0.0:7447#iface=lo", ["0.0.0.0"]),
        ("tls/127.0.0.1:7447", []),
        ("quic/127.0.0.1:7447", []),
        ("unixsock-stream//tmp/socket", []),
    ],
)
def test_the_path_goes_with_tcp_locators(locator: str, hosts: list[str]) -> None:
    config = TransportConfig.for_robot(locator)
    found = stop_path.addresses(config, "listen")
    assert [address[0] for _, address in found] == hosts
    assert all(address[1] == 7447 for _, address in found)


@pytest.mark.parametrize(
    "section",
    [
        {"access_control": {"enabled": True, "default_permission": "allow"}},
        {"transport": {"auth": {"usrpwd": {"user": "me", "password": "secret"}}}},
    ],
)
def test_there_is_no_such_path_where_zenoh_asks_who_somebody_is(
    tmp_path: Path, section: dict[str, object]
) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(json.dumps(section))
    for side, config in (
        ("listen", TransportConfig.for_robot("tcp/127.0.0.1:7447", zenoh_config=file)),
        ("connect", TransportConfig.for_client("tcp/127.0.0.1:7447", zenoh_config=file)),
    ):
        assert stop_path.addresses(config, side) == []


def test_a_taken_port_is_left_alone() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        config = TransportConfig.for_robot(f"tcp/127.0.0.1:{taken.getsockname()[1]}")
        listener = StopListener.open(config, lambda who: None, lambda: StopAnswer("", ""))
        assert listener.where == ()
        assert listener.poll() == 0
