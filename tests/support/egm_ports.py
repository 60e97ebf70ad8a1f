"""UDP ports for tests."""

from __future__ import annotations

import socket


def free_udp_port() -> int:
    """A UDP port on the loopback interface that nobody has bound at the moment."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
