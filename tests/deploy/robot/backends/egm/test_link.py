"""The socket to a controller, and the last look at what leaves it."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Iterator

import numpy as np
import pytest

from skewmi.deploy.robot.backends.egm.codec import MAX_DATAGRAM
from skewmi.deploy.robot.backends.egm.link import DRAINED_AT_ONCE, UdpLink, parse_address
from skewmi.deploy.robot.backends.egm.outgoing import check_reference
from skewmi.deploy.robot.backends.egm.packets import ReferencePacket
from skewmi.deploy.robot.backends.egm.statistics import LinkStatistics
from skewmi.errors import ConfigurationError, LimitViolationError, TransportError
from skewmi.robot_models import yumi


@pytest.fixture
def link() -> Iterator[UdpLink]:
    with UdpLink.open(("127.0.0.1", 0)) as opened:
        yield opened


@pytest.fixture
def sender(link: UdpLink) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        opened.connect(link.address)
        yield opened


def test_datagrams_come_in_order_with_sender_and_arrival(
    link: UdpLink, sender: socket.socket
) -> None:
    before_ns = time.monotonic_ns()
    for number in range(3):
        sender.send(bytes([number]))
    assert link.wait(1_000_000_000)
    time.sleep(0.05)
    got = link.drain()
    assert [datagram.data for datagram in got] == [b"\0", b"\1", b"\2"]
    assert {datagram.sender for datagram in got} == {sender.getsockname()}
    # Arrival is when they came, not when they were read.
    assert all(before_ns - 5_000_000 <= d.arrival_ns <= d.read_ns for d in got)
    assert all(d.read_ns - d.arrival_ns >= 40_000_000 for d in got)
    assert link.drain() == []


def test_waiting_ends(link: UdpLink) -> None:
    assert not link.wait(2_000_000)


def test_what_is_too_long_shows(link: UdpLink, sender: socket.socket) -> None:
    sender.send(bytes(9000))
    assert link.wait(1_000_000_000)
    assert len(link.drain()[0].data) == MAX_DATAGRAM + 1


def test_a_flood_is_taken_in_parts(link: UdpLink, sender: socket.socket) -> None:
    for _ in range(2 * DRAINED_AT_ONCE):
        sender.send(b"flood")
    assert link.wait(1_000_000_000)
    assert len(link.drain()) == DRAINED_AT_ONCE


def test_sending_says_whether_the_system_took_it(link: UdpLink, sender: socket.socket) -> None:
    assert link.send(b"reference", sender.getsockname())
    assert sender.recv(100) == b"reference"
    assert not link.send(bytes(70_000), sender.getsockname())


def test_a_taken_port_is_told(link: UdpLink) -> None:
    with pytest.raises(TransportError, match=str(link.address[1])):
        UdpLink.open(link.address)


@pytest.mark.parametrize("text", ["6512", "127.0.0.1:", ":6512", "127.0.0.1:70000", "1.2.3:x", ""])
def test_addresses_are_checked(text: str) -> None:
    with pytest.raises(ConfigurationError, match="HOST:PORT"):
        parse_address(text)


def test_an_address_is_read() -> None:
    assert parse_address("127.0.0.1:6512") == ("127.0.0.1", 6512)
    assert parse_address("localhost:6512") == ("127.0.0.1", 6512)


def test_ends_of_the_ranges_may_be_sent() -> None:
    for q in (yumi.POSITION_LOWER, yumi.POSITION_UPPER):
        check_reference(ReferencePacket(0, 0, q, yumi.VELOCITY))
        check_reference(ReferencePacket(0, 0, q, -yumi.VELOCITY))
        check_reference(ReferencePacket(0, 0, q))


@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300, "above", "below"])
def test_nothing_else_may(joint: int, value: float | str) -> None:
    q, v = np.zeros(7), np.zeros(7)
    bound = {"above": yumi.POSITION_UPPER, "below": yumi.POSITION_LOWER}
    if isinstance(value, str):
        q[joint] = bound[value][joint] + (1e-6 if value == "above" else -1e-6)
    else:
        q[joint] = value
        v[joint] = value
        with pytest.raises(LimitViolationError, match=f"axis {yumi.ABB_AXES[joint]}"):
            check_reference(ReferencePacket(0, 0, np.zeros(7), v))
    with pytest.raises(LimitViolationError, match=f"axis {yumi.ABB_AXES[joint]}"):
        check_reference(ReferencePacket(0, 0, q, np.zeros(7)))


def test_speeds_beyond_the_axis_may_not() -> None:
    for sign in (1.0, -1.0):
        with pytest.raises(LimitViolationError, match="speed"):
            check_reference(ReferencePacket(0, 0, np.zeros(7), sign * 1.001 * yumi.VELOCITY))


@pytest.mark.parametrize("count", [0, 6, 8])
def test_there_are_seven_joints(count: int) -> None:
    with pytest.raises(LimitViolationError, match="joints"):
        check_reference(ReferencePacket(0, 0, np.zeros(count)))


def test_statistics_of_a_link() -> None:
    statistics = LinkStatistics()
    for _ in range(200):
        statistics.note_packet(1, 4.032e6, 4.032e6)
    for taken_ns in (0.1e6, 0.2e6, 2.5e6, 0.1e6):
        statistics.note_reply(taken_ns)
    statistics.note_packet(3, 3 * 4.032e6, 3 * 4.032e6)
    assert statistics.rate_hz == pytest.approx(248.0, abs=0.1)
    assert statistics.missed == 2
    assert statistics.late_fraction == 0.25
    assert statistics.jitter_ns == 0.0
    statistics.note_packet(1, 6.032e6, 4.032e6)
    assert statistics.jitter_ns == pytest.approx(2e6 / 16)
