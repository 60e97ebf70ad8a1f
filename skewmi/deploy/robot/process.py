"""A robot server as a child process, for runs that bring their own robot."""

from __future__ import annotations

import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from tempfile import TemporaryFile

from skewmi.child import child_command
from skewmi.deploy.robot.description import RobotDescription
from skewmi.errors import TransportError

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
    domain: int = 0,
) -> Iterator[str]:
    """Run `skewmi robot --backend NAME` on a free port until the block is left.

    The child ends with us even if we are killed: its standard input is a pipe of ours.

    Args:
        name: Of the robot, one of `backends.BACKENDS`.
        task: Whose scene.
        limits: Name of the limit profile that it enforces.
        lock_step: See `skewmi robot --help`.
        variation: How robot and scene differ from the nominal ones; None if they do not.
        domain: ROS 2 domain that it is in.

    Yields:
        The Zenoh locator that it listens on.

    Raises:
        TransportError: It ended, or was not ready in time; with its own last words.
    """
    locator = f"tcp/127.0.0.1:{free_port()}"
    command = child_command("-m", "skewmi.cli.main", "robot", "--backend", name)
    command += ["--task", task, "--limits", limits, "--listen", locator]
    command += ["--domain", str(domain)]
    command += ["--json", "--end-with-input", *(["--lock-step"] if lock_step else [])]
    command += [] if variation is None else ["--variation", variation]
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
            watchdog.start()
            if not any(_describes_a_robot(line) for line in child.stdout):
                child.wait(_END_TIMEOUT_S)
                words.seek(0)
                said = words.read().decode(errors="replace").strip().splitlines()
                raise TransportError(
                    f"the robot did not start: {said[-1] if said else 'it was silent'}"
                )
            watchdog.cancel()
            yield locator
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


def _describes_a_robot(line: bytes) -> bool:
    """Whether a line is what `skewmi robot --json` prints once it is ready, and nobody else's."""
    try:
        RobotDescription.from_json(line.decode(errors="replace"))
    except TransportError:
        return False
    return True


def free_port() -> int:
    """A TCP port on the loopback interface that nobody listens on at the moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
