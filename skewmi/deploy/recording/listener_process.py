"""Our side of a process that listens to a link: starts it, feeds it lines, waits for its end.

It is one more subscriber. It costs session and server nothing but the sending of what they send
anyway; its interpreter lock, garbage collector, disk and screen cannot hold them up. It outlives
whoever started it: if that is killed, its end of a pipe closes, and the listener finishes.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
from collections.abc import Mapping
from dataclasses import asdict, replace
from tempfile import TemporaryFile
from typing import IO, Any, Self

from skewmi.child import child_command, told, wait_for_line
from skewmi.deploy.wire.transport import TransportConfig

_START_TIMEOUT_S = 30.0


class ListenerStartError(Exception):
    """The process did not get ready; the message says why."""


class ListenerProcess:
    """A child process that runs one of our listeners; `start` makes one.

    Args:
        process: The child.
        words: Where its standard error goes.
    """

    def __init__(self, process: subprocess.Popen[bytes], words: IO[bytes]) -> None:
        self.process = process
        self._words = words

    @classmethod
    def start(cls, module: str, config: TransportConfig, task: Mapping[str, Any]) -> Self:
        """Start a listener; returns once everything is subscribed to.

        Args:
            module: What to run, as `python -m`.
            config: How to reach the robot server; only its locators, file and domain matter.
            task: What the listener is told first.

        Raises:
            ListenerStartError: It ended, or was not ready in time.
        """
        # A file, because nobody reads while it runs: a full pipe would block it.
        words = TemporaryFile()  # noqa: SIM115 (lives as long as the listener)
        process = subprocess.Popen(
            child_command("-m", module),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=words,
            # A session of its own, so that Ctrl-C reaches the session only.
            start_new_session=True,
        )
        listener = cls(process, words)
        # A listener connects even if its owner listens.
        client = replace(config, connect=config.connect or config.listen, listen=(), server=False)
        listener.write({**task, "config": _config_json(client)})
        assert process.stdout is not None
        if wait_for_line(process.stdout, _is_ready, _START_TIMEOUT_S) is None:
            # If it has said why, it is about to end; otherwise it hangs.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.5)
            process.kill()
            raise ListenerStartError(listener.reason())
        return listener

    def write(self, content: object) -> None:
        """Send a line; not for the hot loop. Nothing happens if the process is gone."""
        assert self.process.stdin is not None
        with contextlib.suppress(OSError, ValueError):
            self.process.stdin.write(json.dumps(content).encode() + b"\n")
            self.process.stdin.flush()

    def finish(self, timeout_s: float) -> dict[str, Any]:
        """Tell the process that this was all, and wait for its last words.

        Raises:
            TimeoutError: It did not end in time, and was killed.
            ValueError: It ended without them.
        """
        try:
            # Closes the pipe: that is how the listener learns that this was all.
            out, _ = self.process.communicate(timeout=timeout_s)
        except subprocess.TimeoutExpired as error:
            self.process.kill()
            raise TimeoutError from error
        last = [content for line in out.splitlines() if (content := told(line)) is not None]
        if not last:
            raise ValueError("the process ended without its last words")
        return last[-1]

    def reason(self) -> str:
        """Why the process ended, in its own words if it had any; waits for the end."""
        self.process.wait()
        self._words.seek(0)
        lines = [s for s in self._words.read().decode(errors="replace").splitlines() if s.strip()]
        return lines[-1] if lines else "the process was killed or hung"


def _is_ready(line: bytes) -> bool:
    return told(line) == {"ready": True}


def _config_json(config: TransportConfig) -> dict[str, object]:
    content = asdict(config)
    if config.zenoh_config is not None:
        content["zenoh_config"] = str(config.zenoh_config)
    return content
