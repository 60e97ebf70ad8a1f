"""The emulated controller's UDP: a queue of messages read one by one, with loss and jitter."""

from __future__ import annotations

import heapq
import socket
from collections import deque
from dataclasses import dataclass
from itertools import count

import numpy as np

from skewmi.deploy.robot.backends.egm.codec import (
    MAX_DATAGRAM,
    MalformedPacketError,
    decode_reference,
    encode_feedback,
)
from skewmi.deploy.robot.backends.egm.packets import FeedbackPacket, ReferencePacket
from skewmi.errors import ConfigurationError, TransportError

QUEUE = 256
"""Messages that wait to be read; a controller that is sent more than it reads falls behind by as
many cycles, until its buffer is full and the newest are lost."""


@dataclass(frozen=True)
class NetworkOptions:
    """What happens to datagrams, both ways and each on its own.

    Raises:
        ConfigurationError: A value makes no sense.
    """

    loss: float = 0.0
    """Probability that one is lost, 0..1."""
    jitter_ms: float = 0.0
    """Each is up to so much later, uniformly drawn, ms; more than a cycle reorders them."""
    seed: int = 0
    """Of both."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.loss < 1.0:
            raise ConfigurationError(f"EGM loss is {self.loss:g}; it must be in 0..1")
        if not 0.0 <= self.jitter_ms <= 1000.0:
            raise ConfigurationError(f"EGM jitter is {self.jitter_ms:g} ms; it must be in 0..1000")


class Wires:
    """One UdpUc device: what is sent to it and what is read from it. Used by one thread.

    Args:
        connected: A non-blocking socket to the device.
        options: What the network does.
    """

    def __init__(self, connected: socket.socket, options: NetworkOptions) -> None:
        self._socket = connected
        self._loss, self._jitter_ns = options.loss, round(1e6 * options.jitter_ms)
        self._rng = np.random.default_rng(options.seed)
        self._order = count()
        self._outgoing: list[tuple[int, int, bytes]] = []
        self._incoming: list[tuple[int, int, bytes]] = []
        self._queue: deque[bytes] = deque()
        self.refused = 0
        """Messages that were not those of a joint correction."""
        self.refusal = ""
        """Why the newest of them was not."""
        self.unsent = 0

    @staticmethod
    def open(remote: tuple[str, int], options: NetworkOptions) -> Wires:
        """Open a socket to a device.

        Args:
            remote: Its address and port.
            options: See the class.

        Raises:
            TransportError: None can be opened.
        """
        try:
            opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            opened.setblocking(False)
            # Connected: the system lets nobody else's datagrams in.
            opened.connect(remote)
        except OSError as error:
            raise TransportError(
                f"cannot send EGM packets to {remote[0]}:{remote[1]}: {error.strerror}"
            ) from error
        return Wires(opened, options)

    def send(self, packet: FeedbackPacket, now_ns: int) -> None:
        """Give a packet to the network."""
        self._give(self._outgoing, encode_feedback(packet), now_ns)
        self.carry(now_ns)

    def carry(self, now_ns: int) -> None:
        """Let what is due by now arrive, on both sides."""
        while self._outgoing and self._outgoing[0][0] <= now_ns:
            data = heapq.heappop(self._outgoing)[2]
            try:
                self._socket.send(data)
            except OSError:
                # The other side is gone, or the network is: as on a real one, nobody is told.
                self.unsent += 1
        # No more than fits: a flood must not keep the controller from its cycle.
        for _ in range(QUEUE):
            try:
                data = self._socket.recv(MAX_DATAGRAM + 1)
            except BlockingIOError:
                break
            except OSError:
                continue
            self._give(self._incoming, data, now_ns)
        while self._incoming and self._incoming[0][0] <= now_ns:
            data = heapq.heappop(self._incoming)[2]
            if len(self._queue) < QUEUE:
                self._queue.append(data)

    @property
    def next_due_ns(self) -> int | None:
        """When `carry` has to be called next for what is on its way; None if nothing is."""
        dues = [pending[0][0] for pending in (self._outgoing, self._incoming) if pending]
        return min(dues, default=None)

    @property
    def waiting(self) -> int:
        """Messages in the queue: cycles by which references are late."""
        return len(self._queue)

    def read(self) -> ReferencePacket | None:
        """The next message of the queue, as a controller reads one in each of its cycles."""
        if not self._queue:
            return None
        try:
            return decode_reference(self._queue.popleft())
        except MalformedPacketError as error:
            self.refused += 1
            self.refusal = str(error)
            return None

    def clear(self) -> None:
        """A new socket on the controller: what waits for the old one is lost."""
        self._queue.clear()

    def close(self) -> None:
        self._socket.close()

    def _give(self, pending: list[tuple[int, int, bytes]], data: bytes, now_ns: int) -> None:
        if self._loss and self._rng.random() < self._loss:
            return
        late_ns = int(self._rng.integers(self._jitter_ns + 1)) if self._jitter_ns else 0
        heapq.heappush(pending, (now_ns + late_ns, next(self._order), data))
