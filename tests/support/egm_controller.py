"""A controller written by hand, for tests of the bridge: sends what it is told, notes every answer.

Nothing of the package's is in it: its bytes are `egm_wire`'s.
"""

from __future__ import annotations

import socket
import time
from dataclasses import replace
from types import TracebackType

from egm_wire import Feedback, Reference

CYCLE_US = 4032
START_US = 1_700_000_000_000_000


class HandController:
    """Sends packets to a bridge and collects its answers.

    Args:
        bridge: Where to.
        axes: Measured degrees of the axes 1 to 6.
        axis_7: Of axis 7.
    """

    def __init__(
        self,
        bridge: tuple[str, int],
        axes: tuple[float, ...] = (0.0, -130.0, 30.0, 0.0, 40.0, 0.0),
        axis_7: float = -135.0,
    ) -> None:
        self.bridge = bridge
        self.socket = self._open()
        self.packet = Feedback(axes=axes, axis_7=(axis_7,))
        """What is sent next, but for its sequence and time."""
        self.sequence = 0
        self.cycles = 0
        self.answers: list[Reference] = []

    @staticmethod
    def _open() -> socket.socket:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.bind(("127.0.0.1", 0))
        opened.setblocking(False)
        return opened

    def __enter__(self) -> HandController:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.socket.close()

    def bytes_of(self, **changes: object) -> bytes:
        """The next packet, with some fields changed; counts it."""
        clock_us = START_US + self.cycles * CYCLE_US
        packet = replace(
            self.packet,
            sequence=self.sequence,
            tm=clock_us // 1000 % 2**32,
            clock=divmod(clock_us, 1_000_000),
        )
        packet = replace(packet, **changes)  # type: ignore[arg-type]
        self.sequence += 1
        self.cycles += 1
        return packet.encode()

    def send(self, **changes: object) -> bytes:
        """Send the next packet, with some fields changed; returns its bytes."""
        data = self.bytes_of(**changes)
        self.socket.sendto(data, self.bridge)
        return data

    def send_bytes(self, data: bytes) -> None:
        self.socket.sendto(data, self.bridge)

    def lose(self, count: int = 1) -> None:
        """Packets that never arrive."""
        self.sequence += count
        self.cycles += count

    def restart(self, *, new_port: bool = False) -> None:
        """A new session: the sequence starts again."""
        self.sequence = 0
        if new_port:
            self.socket.close()
            self.socket = self._open()

    def collect(self, wait_s: float = 0.0) -> list[Reference]:
        """Answers since the last call, the first of which is waited for."""
        fresh: list[Reference] = []
        deadline = time.monotonic() + wait_s
        while True:
            try:
                fresh.append(Reference.decode(self.socket.recv(4096)))
            except BlockingIOError:
                if fresh or time.monotonic() >= deadline:
                    break
                time.sleep(0.0005)
        self.answers += fresh
        return fresh
