"""A second way to stop a robot: datagrams, beside Zenoh and independent of it.

Whatever holds Zenoh up (peers that sleep, a flood) does not hold up a UDP socket that the robot
server's loop looks at in every cycle. It has the address and port of the server's `tcp` locator.
Stopping is all it does: the arm brakes and is disarmed, a fault stays, nothing is armed or moved.
So it gives nobody more than the locator itself does, where anybody who reaches it may stop the arm.
Where Zenoh asks who somebody is (certificates, access rules, passwords), there is no such path: a
datagram tells nobody's name.

A request is `MESSAGE_BYTES` long, an answer no longer: nobody can have others flooded. It carries
a number that the answer repeats, so that who does not see the request cannot answer it.
"""

from __future__ import annotations

import json
import secrets
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

from skewmi.deploy.wire import zenoh_file
from skewmi.deploy.wire.transport_config import TransportConfig

MESSAGE_BYTES = 512

MOST_TAKEN = 256
"""Datagrams that one `poll` looks at."""

MOST_ANSWERED = 8
"""Requests that one `poll` answers; who gets no answer asks again."""

_REQUEST = struct.Struct(">14s?H16s")
"""Magic, whether to stop or only to tell, ROS 2 domain, the request's number."""
_MAGIC = b"skewmi stop 1\0"
_ANSWER_MAGIC = b"skewmi told 1\0"
_HEAD_BYTES = len(_ANSWER_MAGIC) + 16

_AGAIN_S = 0.01
"""Silence after which a request is sent again."""


@dataclass(frozen=True)
class StopAnswer:
    """What a robot server says of itself."""

    state: str
    reason: str


class StopListener:
    """The robot server's end; `open` makes one.

    Args:
        sockets: Bound, not blocking.
        domain: ROS 2 domain of the robot server.
        stop: Told who asks to stop; called at most once for a `poll`.
        tell: What to answer, once that is done.
    """

    def __init__(
        self,
        sockets: list[socket.socket],
        domain: int,
        stop: Callable[[str], None],
        tell: Callable[[], StopAnswer],
    ) -> None:
        self._sockets = sockets
        self._domain = domain
        self._stop = stop
        self._tell = tell
        self._buffer = bytearray(MESSAGE_BYTES + 1)

    @classmethod
    def open(
        cls, config: TransportConfig, stop: Callable[[str], None], tell: Callable[[], StopAnswer]
    ) -> Self:
        """Listen where a robot server's own locators allow it, and its ports are free.

        Args:
            config: Of the robot server.
            stop: See the class.
            tell: See the class.
        """
        bound = [_bound(family, address) for family, address in addresses(config, "listen")]
        sockets = [one for one in bound if one is not None]
        return cls(sockets, config.domain, stop, tell)

    @property
    def where(self) -> tuple[str, ...]:
        """Where it listens, such as udp/127.0.0.1:7447."""
        names = (one.getsockname() for one in self._sockets)
        return tuple(
            f"udp/[{host}]:{port}" if ":" in host else f"udp/{host}:{port}"
            for host, port, *_ in names
        )

    def poll(self) -> int:
        """Look at what has come, a bounded number; how many requests were heard."""
        heard: list[tuple[socket.socket, Any, bytes]] = []
        stopper: str | None = None
        for one in self._sockets:
            for _ in range(MOST_TAKEN // len(self._sockets)):
                try:
                    size, sender = one.recvfrom_into(self._buffer)
                except OSError:  # nothing more, or a sender that is gone
                    break
                if size != MESSAGE_BYTES:
                    continue
                magic, stops, domain, number = _REQUEST.unpack_from(self._buffer)
                if magic != _MAGIC or domain != self._domain:
                    continue
                heard.append((one, sender, number))
                if stops and stopper is None:
                    stopper = f"skewmi stop (a datagram from {sender[0]})"
        if stopper is not None:
            self._stop(stopper)
        if heard:
            self._answer(heard[:MOST_ANSWERED])
        return len(heard)

    def _answer(self, heard: list[tuple[socket.socket, Any, bytes]]) -> None:
        said = self._tell()
        text = _fitting(said)
        for one, sender, number in heard:
            try:
                one.sendto(_ANSWER_MAGIC + number + text, sender)
            except OSError:
                continue  # no room: it asks again

    def close(self) -> None:
        """Listen no more."""
        for one in self._sockets:
            one.close()
        self._sockets = []


def ask(config: TransportConfig, *, stop: bool, timeout_s: float) -> StopAnswer | None:
    """Ask a robot server to stop, or how it is, by datagrams.

    Args:
        config: How to reach it by Zenoh; says whether and where there is this path.
        stop: Whether to stop; else it only tells.
        timeout_s: How long to ask, s.

    Returns:
        What it answered first; None if there is no such path or nobody answers.
    """
    number = secrets.token_bytes(16)
    message = request(config.domain, stop=stop, number=number)
    deadline = time.monotonic() + timeout_s
    sockets = []
    try:
        for family, address in addresses(config, "connect"):
            one = socket.socket(family, socket.SOCK_DGRAM)
            sockets.append(one)
            one.settimeout(_AGAIN_S)
            one.connect(address)
        live = list(sockets)
        while live and time.monotonic() < deadline:
            for one in list(live):
                try:
                    answer = _asked(one, message, number)
                except OSError:  # nobody listens there
                    live.remove(one)
                    continue
                if answer is not None:
                    return answer
    except OSError:
        return None
    finally:
        for one in sockets:
            one.close()
    return None


def addresses(config: TransportConfig, side: str) -> list[tuple[int, Any]]:
    """Family and address of each datagram path that goes with a configuration.

    Args:
        config: How a link is opened.
        side: "connect" or "listen".
    """
    zenoh_config = config.zenoh()
    if zenoh_file.asks_who(zenoh_config):
        return []
    found: list[tuple[int, Any]] = []
    for locator in zenoh_file.locators(zenoh_config, side):
        protocol, _, rest = locator.partition("/")
        host, _, port = rest.partition("#")[0].partition("?")[0].rpartition(":")
        if protocol != "tcp" or not port.isdecimal():
            continue
        try:
            resolved = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_DGRAM)
        except OSError:
            continue
        found += [(family, address) for family, _, _, _, address in resolved]
    return found


def request(domain: int, *, stop: bool, number: bytes) -> bytes:
    """A request's bytes.

    Args:
        domain: ROS 2 domain of the robot server.
        stop: Whether to stop; else it only tells.
        number: That the answer repeats. 16 bytes.
    """
    return _REQUEST.pack(_MAGIC, stop, domain, number).ljust(MESSAGE_BYTES, b"\0")


def _asked(one: socket.socket, message: bytes, number: bytes) -> StopAnswer | None:
    try:
        one.send(message)
        while True:
            said = one.recv(MESSAGE_BYTES)
            if said[:_HEAD_BYTES] == _ANSWER_MAGIC + number:
                return _read(said[_HEAD_BYTES:])
    except TimeoutError:
        return None


def _fitting(said: StopAnswer) -> bytes:
    """An answer's text; the reason is cut so that it fits."""
    reason = said.reason
    while True:
        text = json.dumps({"state": said.state, "reason": reason}).encode()
        if len(text) <= MESSAGE_BYTES - _HEAD_BYTES or not reason:
            return text
        reason = reason[: len(reason) // 2]


def _read(text: bytes) -> StopAnswer | None:
    try:
        content = json.loads(text)
        return StopAnswer(str(content["state"]), str(content["reason"]))
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def _bound(family: int, address: Any) -> socket.socket | None:
    one = socket.socket(family, socket.SOCK_DGRAM)
    try:
        one.setblocking(False)
        one.bind(address)
    except OSError:
        one.close()
        return None
    return one
