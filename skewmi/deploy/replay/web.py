"""Rerun's web viewer, served by this process: for machines without a screen."""

from __future__ import annotations

import socket
from typing import Any
from urllib.parse import quote

import rerun as rr

from skewmi.errors import ConfigurationError

HOST = "127.0.0.1"
"""Nobody from outside can look."""
DATA_PORT, PAGE_PORT = 9876, 9090
"""Rerun's own, taken if they are free."""


def free_ports() -> tuple[int, int]:
    """Ports for the data and for the page."""
    return _free(DATA_PORT), _free(PAGE_PORT)


def address(ports: tuple[int, int]) -> str:
    """What to open in a browser on this machine."""
    data = quote(f"rerun+http://{HOST}:{ports[0]}/proxy", safe="")
    return f"http://{HOST}:{ports[1]}/?url={data}"


def serve(stream: Any, ports: tuple[int, int]) -> None:
    """Serve a recording, and the viewer for it, as long as this process runs.

    Args:
        stream: A `rerun.RecordingStream` without a sink.
        ports: Of `free_ports`.

    Raises:
        ConfigurationError: A port is taken meanwhile, or the viewer's pages are not installed.
    """
    try:
        stream.serve_grpc(grpc_port=ports[0], cors_allow_origin=[f"http://{HOST}:{ports[1]}"])
        rr.serve_web_viewer(web_port=ports[1], open_browser=False)
    except (RuntimeError, ValueError, OSError) as error:
        raise ConfigurationError(f"cannot serve a web viewer: {error}") from error


def _free(wanted: int) -> int:
    """A port on this machine that nobody listens on: the wanted one, if that is so."""
    for port in (wanted, 0):
        with socket.socket() as probe:
            try:
                probe.bind((HOST, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise ConfigurationError(f"no port is free on {HOST}; end a program that listens there")
