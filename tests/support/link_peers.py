"""Other processes with a link of their own."""

from __future__ import annotations

import subprocess
import sys
import textwrap
import time

PEER = """
import sys, time
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import Link, TransportConfig
with Link.open(TransportConfig.for_client(sys.argv[1]), "peer") as link:
    {body}
"""


def start_peer(locator: str, body: str) -> subprocess.Popen[str]:
    """Another process with a link, running `body`."""
    code = PEER.format(body=textwrap.indent(textwrap.dedent(body), "    ").strip())
    return subprocess.Popen(
        [sys.executable, "-c", code, locator],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def output_of(peer: subprocess.Popen[str]) -> str:
    out, error = peer.communicate(timeout=30)
    assert peer.returncode == 0, error
    return out.strip()


def eventually(condition, timeout_s: float = 30.0):
    """First true value of `condition()`."""
    deadline = time.monotonic() + timeout_s
    while not (value := condition()):
        assert time.monotonic() < deadline, "never became true"
        time.sleep(0.01)
    return value
