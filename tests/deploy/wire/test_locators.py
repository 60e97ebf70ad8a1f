"""Whatever Zenoh takes for a locator, our options take; the rest is refused in words."""

from __future__ import annotations

from pathlib import Path

import pytest

from skewmi.deploy.wire.transport import Link
from skewmi.deploy.wire.transport_config import TransportConfig
from skewmi.errors import ConfigurationError

TAKEN = (
    "tcp/127.0.0.1:7447",
    "tcp/[::1]:7447",
    "tls/robot.lab:7447#enable_mtls=true",
    "quic/robot:7447",
    "unixsock-stream//run/skewmi.sock",
    "unixpipe//tmp/pipe",
    "vsock/-1:1234",
    "serial//dev/ttyUSB0#baudrate=112500",
)
REFUSED = ("", "tcp", "tcp/", "127.0.0.1:7447", "localhost")


@pytest.mark.parametrize("locator", TAKEN)
def test_zenohs_locators_are_taken(locator: str) -> None:
    assert TransportConfig.for_client(locator).connect == (locator,)
    assert TransportConfig.for_robot(locator).listen == (locator,)


@pytest.mark.parametrize("locator", REFUSED)
def test_what_is_no_locator_is_refused(locator: str) -> None:
    for make in (TransportConfig.for_client, TransportConfig.for_robot):
        with pytest.raises(ConfigurationError, match="write one like"):
            make(locator)


def test_a_socket_in_the_file_system_is_a_link(tmp_path: Path) -> None:
    locator = f"unixsock-stream/{tmp_path}/s.sock"
    robot = TransportConfig.for_robot(locator)
    assert robot.unprotected == ()
    with (
        Link.open(robot, "robot"),
        Link.open(TransportConfig.for_client(locator), "client") as client,
    ):
        assert client.session_id
