"""Fixtures for tests of the bridge."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from egm_bench import Bench
from egm_channel import RAMP_NS, Clock, Controller

from skewmi.deploy.robot.backends.egm.channel import ArmChannel
from skewmi.deploy.robot.backends.egm.link import UdpLink


@pytest.fixture
def bench() -> Iterator[Bench]:
    """A bridge with default options but no left arm."""
    with Bench() as opened:
        yield opened


@pytest.fixture
def channel() -> Iterator[ArmChannel]:
    with UdpLink.open(("127.0.0.1", 0), Clock()) as link:
        yield ArmChannel(link, RAMP_NS)


@pytest.fixture
def controller(channel: ArmChannel) -> Iterator[Controller]:
    clock = channel.link.now_ns
    assert isinstance(clock, Clock)
    with Controller(channel.link.address, clock) as opened:
        yield opened
