"""Rerun viewers: one of our own, or one that already runs."""

from __future__ import annotations

import math
import os
import re
import socket
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from skewmi.errors import ConfigurationError
from skewmi.extras import install_line
from skewmi.privacy import viewer_environment

DEFAULT_URL = "rerun+http://127.0.0.1:9876/proxy"
"""Where Rerun's viewers listen unless told otherwise."""

_URL = re.compile(r"rerun(?:\+https?)?://(?P<host>\[[^\]]+\]|[^/:\[\]]+):(?P<port>\d+)/proxy")
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
_START_TIMEOUT_S = 20.0


def check_url(url: str) -> tuple[str, int]:
    """Host and port of a viewer's address.

    Raises:
        ConfigurationError: It is not one.
    """
    match = _URL.fullmatch(url)
    if match is None or not 0 < int(match["port"]) < 65536:
        raise ConfigurationError(
            f"{url!r} is not the address of a Rerun viewer; write one like {DEFAULT_URL}"
        )
    return match["host"].strip("[]"), int(match["port"])


def require_viewer(url: str) -> None:
    """Make sure that somebody listens there: Rerun itself would wait without a word.

    Raises:
        ConfigurationError: The address is wrong, or nobody does.
    """
    host, port = check_url(url)
    if not _listens(host, port, timeout_s=3.0):
        raise ConfigurationError(
            f"no Rerun viewer listens at {url}; start one there with: rerun --port {port}"
        )


def has_screen() -> bool:
    """Whether a viewer of our own could be seen here."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in _SCREENS)


def is_there(url: str = DEFAULT_URL) -> bool:
    """Whether a viewer listens already."""
    return _listens(*check_url(url), timeout_s=0.5)


def spawn_viewer(otherwise: str, url: str = DEFAULT_URL) -> str:
    """Open a viewer that outlives us, unless one listens there already; return its address.

    Args:
        otherwise: What to do without a viewer, for messages.
        url: Its address, on this machine.

    Raises:
        ConfigurationError: It cannot be started; most often there is no display.
    """
    host, port = check_url(url)
    if _listens(host, port, timeout_s=0.5):
        return url
    if not has_screen():
        raise ConfigurationError(
            f"there is no screen for a Rerun viewer (none of {', '.join(_SCREENS)} is set); "
            f"{otherwise}"
        )
    command = [str(executable()), "--port", str(port), "--bind", host, "--expect-data-soon"]
    # Its welcome screen fetches a list of examples from the network.
    command.append("--hide-welcome-screen")
    with TemporaryFile() as words:
        try:
            child = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=words,
                stderr=words,
                # Ctrl-C ends the run, not the view of it.
                start_new_session=True,
                env={**viewer_environment(), "RERUN_APP_ONLY": "true", "NO_COLOR": "1"},
            )
        except OSError as error:
            raise ConfigurationError(
                f"cannot start a Rerun viewer ({error}); {otherwise}"
            ) from error
        deadline = time.monotonic() + _START_TIMEOUT_S
        while child.poll() is None and time.monotonic() < deadline:
            if _listens(host, port, timeout_s=0.2) and _stays(child):
                return url
            time.sleep(0.05)
        words.seek(0)
        lines = words.read().decode(errors="replace").splitlines()
    if child.poll() is None:
        child.kill()
        child.wait()
        lines.append(f"it does not listen within {_START_TIMEOUT_S:g} s")
    last = next((line for line in reversed(lines) if line.strip()), "it was silent")
    raise ConfigurationError(f"cannot start a Rerun viewer ({last.strip()}); {otherwise}")


def send_rest(stream: Any, timeout_s: float = math.inf) -> None:
    """Wait until a viewer has taken everything that was drawn.

    Args:
        stream: A `rerun.RecordingStream` that is connected to it.
        timeout_s: For how long, s.

    Raises:
        ConfigurationError: It has not; it was closed, for instance.
    """
    try:
        stream.flush(timeout_sec=timeout_s)
    except (RuntimeError, ValueError) as error:
        words = " ".join(str(error).split())
        raise ConfigurationError(f"the Rerun viewer has not taken everything: {words}") from error


def _stays(child: subprocess.Popen[bytes]) -> bool:
    """Whether a viewer that listens has found a screen, too: it looks for one a little later."""
    try:
        child.wait(1.0)
    except subprocess.TimeoutExpired:
        return True
    return False


def _listens(host: str, port: int, *, timeout_s: float) -> bool:
    try:
        socket.create_connection((host, port), timeout_s).close()
    except OSError:
        return False
    return True


def executable() -> Path:
    """The viewer that comes with the Python package: its folder need not be on the PATH.

    Raises:
        ConfigurationError: It is missing.
    """
    found = find_spec("rerun_cli")
    folders = () if found is None else found.submodule_search_locations or ()
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    path = Path(os.environ.get("RERUN_CLI_PATH") or Path(*folders[:1], name))
    if not path.is_file():
        raise ConfigurationError(f"there is no Rerun viewer at {path}: {install_line('view')}")
    return path
