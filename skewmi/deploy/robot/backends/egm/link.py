"""The UDP socket that a controller sends to: what came since last time, and one reply a cycle.

A controller reads one message a cycle and keeps the others in a queue. So a second reply within a
cycle delays all later ones for ever: only the newest packet is answered, and only once.
"""

from __future__ import annotations

import select
import socket
import struct
import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import NamedTuple

from skewmi.deploy.robot.backends.egm.codec import MAX_DATAGRAM
from skewmi.errors import ConfigurationError, TransportError

DRAINED_AT_ONCE = 64
"""Datagrams that are taken from the socket before the newest packet is answered: a flood must not
hold up the reply. Those beyond wait for the next cycle, or the system drops them."""

_RECEIVE_BUFFER = 1 << 18
_SO_TIMESTAMPNS = 35  # Linux, asm-generic/socket.h; Python has no name for it.
_STAMP = struct.Struct("@ll")
_ANCILLARY_BYTES = socket.CMSG_SPACE(_STAMP.size) if hasattr(socket, "CMSG_SPACE") else 0


class Datagram(NamedTuple):
    """Bytes and where they came from.

    `data` is one byte longer than any packet may be if the datagram was too long. `arrival_ns` is
    when they reached this computer and `read_ns` when this process came to them, both by
    `time.monotonic_ns`.
    """

    data: bytes
    sender: tuple[str, int]
    arrival_ns: int
    read_ns: int


def parse_address(text: str) -> tuple[str, int]:
    """`HOST:PORT` as an IPv4 address and a port.

    Raises:
        ConfigurationError: It is not one.
    """
    host, _, port = text.rpartition(":")
    try:
        return _ipv4(host), _port(port)
    except (ValueError, OSError):
        raise ConfigurationError(
            f"{text!r} is not HOST:PORT with an IPv4 address and a port of 0..65535, such as "
            "192.168.125.50:6512"
        ) from None


def _ipv4(host: str) -> str:
    return socket.inet_ntoa(socket.inet_aton(host)) if host.count(".") == 3 else _by_name(host)


def _by_name(host: str) -> str:
    if not host:
        raise ValueError(host)
    return socket.gethostbyname(host)


def _port(text: str) -> int:
    number = int(text)
    if not 0 <= number <= 65535:
        raise ValueError(text)
    return number


class UdpLink:
    """A bound socket. Used by one thread.

    Args:
        bound: The socket, non-blocking.
        now_ns: The monotonic clock; tests have their own.
    """

    def __init__(self, bound: socket.socket, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.now_ns = now_ns
        self._socket = bound
        self._stamped = _ask_for_stamps(bound)
        self._poll = select.poll()
        self._poll.register(bound, select.POLLIN)

    @staticmethod
    def open(listen: tuple[str, int], now_ns: Callable[[], int] = time.monotonic_ns) -> UdpLink:
        """Bind a socket.

        Args:
            listen: Address and port; port 0 takes a free one.
            now_ns: See the class.

        Raises:
            TransportError: It cannot be bound.
        """
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            opened.setblocking(False)
            opened.bind(listen)
        except OSError as error:
            opened.close()
            raise TransportError(
                f"cannot listen for a controller on {listen[0]}:{listen[1]}/udp: {error.strerror}; "
                "is another bridge running, and is the address one of this computer's?"
            ) from error
        return UdpLink(opened, now_ns)

    def __enter__(self) -> UdpLink:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def address(self) -> tuple[str, int]:
        """What it is bound to."""
        host, port = self._socket.getsockname()
        return host, port

    def fileno(self) -> int:
        """For those who wait for several links at once."""
        return self._socket.fileno()

    def wait(self, timeout_ns: int) -> bool:
        """Wait until something has come, no longer than `timeout_ns`; says whether it has."""
        # Milliseconds are all that poll knows; it rounds up, and half of one is too long to miss.
        return bool(self._poll.poll(max(timeout_ns, 0) / 1e6))

    def drain(self) -> list[Datagram]:
        """What has come, oldest first, but no more than `DRAINED_AT_ONCE`."""
        now_ns, now_real_ns = self.now_ns(), time.time_ns()
        datagrams: list[Datagram] = []
        for _ in range(DRAINED_AT_ONCE):
            try:
                data, ancillary, _, sender = self._socket.recvmsg(
                    MAX_DATAGRAM + 1, _ANCILLARY_BYTES if self._stamped else 0
                )
            except BlockingIOError:
                break
            except OSError:
                # The network's answer to something that we sent: nobody listens there.
                continue
            age_ns = now_real_ns - _stamp_ns(ancillary, now_real_ns)
            # The system's wall clock may be set; nothing has waited for a second.
            age_ns = age_ns if 0 <= age_ns < 1_000_000_000 else 0
            datagrams.append(Datagram(data, sender, now_ns - age_ns, now_ns))
        return datagrams

    def send(self, data: bytes, to: tuple[str, int]) -> bool:
        """Send a datagram; says whether the system took it. Never waits."""
        try:
            return self._socket.sendto(data, to) == len(data)
        except OSError:
            return False

    def close(self) -> None:
        self._socket.close()


def _ask_for_stamps(bound: socket.socket) -> bool:
    """Ask the kernel to say when a datagram arrived, not when we came to read it."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        bound.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    except OSError:
        return False
    return True


def _stamp_ns(ancillary: list[tuple[int, int, bytes]], fallback_ns: int) -> int:
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(data) >= _STAMP.size:
            seconds, nanoseconds = _STAMP.unpack_from(data)
            return int(seconds) * 1_000_000_000 + int(nanoseconds)
    return fallback_ns
