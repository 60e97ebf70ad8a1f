"""What listens when nobody asks for more, and which doors count as open."""

from __future__ import annotations

import json
import os
import socket
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from secured_link import SecuredLink, robot_process

from skewmi.deploy.robot.process import free_port
from skewmi.deploy.wire.access import Role
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import TransportError

needs_proc = pytest.mark.skipif(
    not Path("/proc/net/tcp").exists(), reason="reads the kernel's table of sockets"
)

OPEN = """
import json, sys, zenoh
from pathlib import Path
from skewmi.deploy.wire.transport import TransportConfig
kind, port, file = sys.argv[1:]
file = Path(file) if file else None
if kind == "zenoh alone":
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", json.dumps([f"tcp/[::]:{port}"]))
elif kind == "server":
    config = TransportConfig.for_robot(zenoh_config=file).zenoh()
    # Where it listens by default, but for the port, which another test may be using.
    where = json.loads(config.get_json("listen/endpoints"))
    moved = [locator.replace(":7447", f":{port}") for locator in where]
    config.insert_json5("listen/endpoints", json.dumps(moved))
else:
    config = TransportConfig.for_client(f"tcp/127.0.0.1:{port}", zenoh_config=file).zenoh()
with zenoh.open(config):
    print("open", flush=True)
    sys.stdin.readline()
"""


def start(kind: str, port: int, file: Path | None = None) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", OPEN, kind, str(port), str(file or "")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "open\n"
    return process


def end(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.communicate()


def sockets(pid: int) -> tuple[set[tuple[str, int]], set[tuple[str, int]]]:
    """Addresses and ports that a process listens on by TCP, and those of its UDP sockets."""
    inodes = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = os.readlink(descriptor)
        except FileNotFoundError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    found: dict[str, set[tuple[str, int]]] = {"tcp": set(), "udp": set()}
    for table in ("tcp", "tcp6", "udp", "udp6"):
        path = Path(f"/proc/{pid}/net/{table}")
        for line in path.read_text().splitlines()[1:] if path.exists() else ():
            fields = line.split()
            if fields[9] in inodes and (table.startswith("udp") or fields[3] == "0A"):
                found[table[:3]].add(address(fields[1]))
    return found["tcp"], found["udp"]


def address(field: str) -> tuple[str, int]:
    """As the kernel prints it: words in the machine's byte order, then the port."""
    host, port = field.split(":")
    words = [int(host[i : i + 8], 16) for i in range(0, len(host), 8)]
    packed = struct.pack(f"={len(words)}I", *words)
    family = socket.AF_INET if len(packed) == 4 else socket.AF_INET6
    return socket.inet_ntop(family, packed), int(port, 16)


@needs_proc
def test_by_default_only_loopback_is_listened_on_and_nothing_is_searched(tmp_path: Path) -> None:
    empty = tmp_path / "empty.json5"
    empty.write_text("{}")
    for file in (None, empty):
        port = free_port()
        server = start("server", port, file)
        try:
            assert sockets(server.pid) == ({("127.0.0.1", port)}, set())
            client = start("client", port, file)
            try:
                assert sockets(client.pid) == (set(), set())
            finally:
                end(client)
        finally:
            end(server)


@needs_proc
def test_the_look_at_sockets_sees_what_zenoh_opens_by_itself() -> None:
    """Else the test above could not fail."""
    port = free_port()
    process = start("zenoh alone", port)
    try:
        listening, datagrams = sockets(process.pid)
        assert ("::", port) in listening
        assert datagrams, "Zenoh's own default looks for others by multicast"
    finally:
        end(process)


@needs_proc
def test_robot_commands_listen_only_where_they_are_told_to(tmp_path: Path) -> None:
    port = free_port()
    with robot_process("--listen", f"tcp/127.0.0.1:{port}") as plain:
        # The datagrams are those that stop the arm.
        assert sockets(plain.pid) == ({("127.0.0.1", port)}, {("127.0.0.1", port)})
    link = SecuredLink(tmp_path, host="127.0.0.1")
    with robot_process("--zenoh-config", str(link.file(Role.ROBOT))) as secured:
        assert sockets(secured.pid) == ({("127.0.0.1", link.plan.port)}, set())


def test_what_a_file_says_is_kept_and_what_it_leaves_open_is_safe(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text('{listen: {endpoints: ["tcp/10.0.0.7:1"]}, connect: {timeout_ms: 77}}')
    server = TransportConfig.for_robot(zenoh_config=file)
    config = server.zenoh()
    assert json.loads(config.get_json("listen/endpoints")) == ["tcp/10.0.0.7:1"]
    assert json.loads(config.get_json("connect/timeout_ms")) == 77
    assert json.loads(config.get_json("mode")) == "router"
    assert server.where == "tcp/10.0.0.7:1"
    assert server.unprotected == ("tcp/10.0.0.7:1",)
    for kind in ("multicast", "gossip"):
        assert config.get_json(f"scouting/{kind}/enabled") == "false"
    file.write_text("{scouting: {multicast: {enabled: true}}}")
    config = TransportConfig.for_robot(zenoh_config=file).zenoh()
    assert config.get_json("scouting/multicast/enabled") == "true", "asked for in so many words"
    assert json.loads(config.get_json("listen/endpoints")) == ["tcp/127.0.0.1:7447"]
    client = TransportConfig.for_client(zenoh_config=file)
    assert client.where == "tcp/127.0.0.1:7447"
    over = TransportConfig.for_client("tcp/127.0.0.1:5", zenoh_config=file)
    assert over.where == "tcp/127.0.0.1:5"


@pytest.mark.parametrize(
    ("locator", "unprotected"),
    [
        ("tcp/127.0.0.1:7447", False),
        ("tcp/127.1.2.3:7447", False),
        ("tcp/[::1]:7447", False),
        ("tcp/localhost:7447", False),
        ("tls/127.0.0.1:7447", False),
        ("unixpipe//tmp/skewmi", False),
        ("tcp/0.0.0.0:7447", True),
        ("tcp/[::]:7447", True),
        ("udp/10.0.0.7:7447", True),
        ("ws/robot.lab:7447", True),
        ("tcp/10.0.0.7:7447#iface=lo", True),
        ("tls/0.0.0.0:7447", True),
        ("quic/robot.lab:7447", True),
    ],
)
def test_open_doors_are_recognised(locator: str, unprotected: bool) -> None:
    assert TransportConfig.for_robot(locator).unprotected == ((locator,) if unprotected else ())


@pytest.mark.parametrize("protocol", ["tls", "quic"])
@pytest.mark.parametrize(
    ("mutual", "own", "unprotected"),
    [
        ("true", "", False),
        ("false", "", True),
        ("null", "", True),
        # What the locator says comes before what the file says; of two, the first counts.
        ("true", "#enable_mtls=false;iface=lo", True),
        ("true", "?rel=1#enable_mtls=false;enable_mtls=true", True),
        ("false", "#enable_mtls=true", False),
    ],
)
def test_tls_protects_only_if_it_asks_for_certificates(
    tmp_path: Path, protocol: str, mutual: str, own: str, unprotected: bool
) -> None:
    locator = f"{protocol}/0.0.0.0:7447{own}"
    file = tmp_path / "zenoh.json5"
    file.write_text(
        f'{{listen: {{endpoints: ["{locator}", "{protocol}/127.0.0.1:7448"]}}, '
        f"transport: {{link: {{tls: {{enable_mtls: {mutual}}}}}}}}}"
    )
    config = TransportConfig.for_robot(zenoh_config=file)
    assert config.unprotected == ((locator,) if unprotected else ())


@pytest.mark.parametrize(
    ("mutual", "own", "let_in"),
    [(True, "", False), (False, "", True), (True, "#enable_mtls=false", True)],
)
def test_zenoh_lets_in_without_certificate_where_we_say_so(
    tmp_path: Path, mutual: bool, own: str, let_in: bool
) -> None:
    link = SecuredLink(tmp_path)
    text = link.file(Role.ROBOT).read_text()
    content = json.loads(text[text.index("{") :])
    content["transport"]["link"]["tls"]["enable_mtls"] = mutual
    content["listen"]["endpoints"][0] += own
    del content["access_control"]
    file = link.file(Role.ROBOT).with_name("changed.json5")
    file.write_text(json.dumps(content))

    def without_certificate(content: dict[str, Any]) -> None:
        tls = content["transport"]["link"]["tls"]
        del content["access_control"], tls["connect_certificate"], tls["connect_private_key"]
        tls["enable_mtls"] = False

    stranger = link.intruder(Role.COMMANDER, without_certificate)
    with Link.open(TransportConfig.for_robot(zenoh_config=file), "server"):
        try:
            Link.open(stranger, "stranger").close()
        except TransportError:
            assert not let_in
        else:
            assert let_in
