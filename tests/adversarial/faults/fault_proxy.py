"""A TCP connection that can fall silent, as a pulled cable does, or break, as a switch does."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from typing import Self

_PIECE = 65536


class TcpProxy:
    """Relays connections to a Zenoh locator; a context manager that closes them.

    Args:
        target: Locator, tcp/HOST:PORT.
    """

    def __init__(self, target: str) -> None:
        host, _, port = target.partition("/")[2].rpartition(":")
        self._target = host, int(port)
        self._server = socket.create_server(("127.0.0.1", 0))
        self.locator = f"tcp/127.0.0.1:{self._server.getsockname()[1]}"
        self._open = threading.Event()
        self._open.set()
        self._refuse = False
        self._sockets: list[socket.socket] = []

    def __enter__(self) -> Self:
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._open.set()
        self._server.close()
        self._close()

    def silence(self, duration_s: float) -> None:
        """Hold every byte back for a while; then all of them arrive at once."""
        self._open.clear()
        threading.Timer(duration_s, self._open.set).start()

    def cut(self, duration_s: float) -> None:
        """Break all connections, and accept none for a while."""
        self._refuse = True
        self._close()

        def restore() -> None:
            self._refuse = False

        threading.Timer(duration_s, restore).start()

    def _close(self) -> None:
        sockets, self._sockets = self._sockets, []
        for one in sockets:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._server.accept()
                if self._refuse:
                    near.close()
                    time.sleep(0.01)
                    continue
                far = socket.create_connection(self._target)
                for one in (near, far):
                    one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._sockets += [near, far]
                for pair in ((near, far), (far, near)):
                    threading.Thread(target=self._relay, args=pair, daemon=True).start()

    def _relay(self, source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while piece := source.recv(_PIECE):
                self._open.wait()
                sink.sendall(piece)
            sink.shutdown(socket.SHUT_WR)
