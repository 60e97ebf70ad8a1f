"""A robot server as a child process, for runs that bring their own robot."""

from __future__ import annotations

import json
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile

from skewmi.child import child_command
from skewmi.errors import TransportError

EMULATOR = "egm-emulator"
"""A robot that is two processes: the bridge to a controller, and an emulated controller."""

EMULATED_COMM_TIMEOUT_S = 0.1
"""CommTimeout of the emulated controller that is started with its bridge: what `rapid/` sets."""

_READY_TIMEOUT_S = 60.0
_END_TIMEOUT_S = 10.0


@contextmanager
def spawn_robot(
    name: str,
    task: str,
    limits: str,
    *,
    lock_step: bool,
    variation: str | None = None,
    calibration: Path | None = None,
    domain: int = 0,
    meanwhile: Callable[[], object] = lambda: None,
) -> Iterator[str]:
    """Run `skewmi robot --backend NAME` on a free port until the block is left.

    The children end with us even if we are killed: their standard input is a pipe of ours.

    Args:
        name: Of the robot: one of `backends.BACKENDS`, or `EMULATOR`.
        task: Whose scene.
        limits: Name of the limit profile that it enforces.
        lock_step: See `skewmi robot --help`.
        variation: How robot and scene differ from the nominal ones; None if they do not.
        calibration: File of what is known of its servos; None if nothing is.
        domain: ROS 2 domain that it is in.
        meanwhile: Done here while it starts.

    Yields:
        The Zenoh locator that it listens on.

    Raises:
        TransportError: It ended, or was not ready in time; with its own last words.
    """
    locator = f"tcp/127.0.0.1:{free_port()}"
    if name not in (EMULATOR, "egm"):
        run = {
            "backend": name,
            "task": task,
            "limits": limits,
            "listen": locator,
            "domain": domain,
            "lock_step": lock_step,
            "variation": variation,
            "calibration": None if calibration is None else str(calibration),
        }
        command = child_command("-m", "skewmi.deploy.robot.robot_process", json.dumps(run))
        with _child(name, command, meanwhile):
            yield locator
        return
    server = ["--task", task, "--limits", limits, "--listen", locator, "--domain", str(domain)]
    server += ["--lock-step"] if lock_step else []
    server += [] if calibration is None else ["--calibration", str(calibration)]
    varied = [] if variation is None else ["--variation", variation]
    if name != EMULATOR:
        with _child(name, _command(name, [*server, *varied]), meanwhile):
            yield locator
        return
    scene = ["--task", task, "--connect", locator, "--domain", str(domain), *varied]
    with _emulated(server, scene, meanwhile):
        yield locator


@contextmanager
def _emulated(
    server: list[str], scene: list[str], meanwhile: Callable[[], object]
) -> Iterator[None]:
    """The bridge to a real robot's controller, and an emulated one at its other end.

    Args:
        server: Options of the bridge.
        scene: Options of the emulated controller.
        meanwhile: See `spawn_robot`.
    """
    right, left = (f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}" for _ in range(2))
    bridge = [*server, "--egm-listen", right, "--egm-listen-left", left]
    controller = [*scene, "--egm-remote", right, "--egm-remote-left", left]
    controller += ["--egm-comm-timeout-s", f"{EMULATED_COMM_TIMEOUT_S}"]
    with (
        _child("egm", _command("egm", bridge), meanwhile),
        _child(EMULATOR, _command(EMULATOR, controller)),
    ):
        yield


def _command(backend: str, options: list[str]) -> list[str]:
    command = child_command("-m", "skewmi.cli.main", "robot", "--backend", backend)
    return [*command, *options, "--json", "--end-with-input"]


@contextmanager
def _child(
    backend: str, command: list[str], meanwhile: Callable[[], object] = lambda: None
) -> Iterator[None]:
    with TemporaryFile() as words:
        child = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=words,
            # Ctrl-C reaches us alone: the arm shall brake before its robot goes away.
            start_new_session=True,
        )
        watchdog = threading.Timer(_READY_TIMEOUT_S, child.kill)
        watchdog.daemon = True
        try:
            assert child.stdout is not None
            meanwhile()
            watchdog.start()
            if not any(_is_ready(line, backend) for line in child.stdout):
                child.wait(_END_TIMEOUT_S)
                words.seek(0)
                said = words.read().decode(errors="replace").strip().splitlines()
                raise TransportError(
                    f"the robot did not start: {said[-1] if said else 'it was silent'}"
                )
            watchdog.cancel()
            yield
        finally:
            watchdog.cancel()
            _end(child)


def _end(child: subprocess.Popen[bytes]) -> None:
    """Let the robot come to rest; kill it if it does not end."""
    assert child.stdin is not None
    child.stdin.close()
    try:
        child.wait(_END_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()
    if child.stdout is not None:
        child.stdout.close()


def _is_ready(line: bytes, backend: str) -> bool:
    """Whether a line is what `skewmi robot --json` prints once it is ready, and nobody else's."""
    try:
        return bool(json.loads(line)["backend"] == backend)
    except (ValueError, TypeError, KeyError):
        return False


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """A TCP (or UDP) port on the loopback interface that nobody listens on at the moment."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
