"""Where links of tests meet."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest
from secured_commands import stop_and_rest
from secured_link import SecuredLink, robot_process

from skewmi.deploy.wire.access import Role
from skewmi.deploy.wire.transport import Link


@pytest.fixture
def locator() -> str:
    """A loopback port that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecuredLink]:
    link = SecuredLink(tmp_path_factory.mktemp("link"))
    with robot_process("--zenoh-config", str(link.file(Role.ROBOT))):
        yield link


@pytest.fixture
def commander(secured: SecuredLink) -> Iterator[Link]:
    """The rightful one; finds and leaves the robot server disarmed, its arm at the start."""
    with Link.open(secured.config(Role.COMMANDER), "commander") as link:
        link.wait_for_robot(10.0)
        stop_and_rest(link)
        yield link
        stop_and_rest(link)
