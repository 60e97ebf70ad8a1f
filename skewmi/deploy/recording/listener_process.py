"""Our side of a process that listens to a link: starts it, feeds it lines, waits for its end.

It is one more subscriber. It costs session and server nothing but the sending of what they send
anyway; its interpreter lock, garbage collector, disk and screen cannot hold them up.
"""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any, Self

from skewmi.child import told
from skewmi.child_process import ChildProcess
from skewmi.deploy.wire.transport import TransportConfig

_START_TIMEOUT_S = 60.0
_FINISH_LONGEST_S = 120.0


class ListenerProcess(ChildProcess):
    """A child process that runs one of our listeners; `start` makes one."""

    @classmethod
    def start(cls, module: str, config: TransportConfig, task: Mapping[str, Any]) -> Self:
        """Start a listener; returns once everything is subscribed to.

        Args:
            module: What to run, as `python -m`.
            config: How to reach the robot server; only its locators, file and domain matter.
            task: What the listener is told first.

        Raises:
            ChildStartError: It ended, or was not ready in time.
        """
        # A listener connects even if its owner listens.
        client = replace(config, connect=config.connect or config.listen, listen=(), server=False)
        return cls.launch(module, {**task, "config": _config_json(client)}, _START_TIMEOUT_S)

    def finish(self, idle_s: float) -> dict[str, Any]:
        """Tell the process that this was all, and wait for its last words.

        Args:
            idle_s: For how long it may do nothing, s.

        Raises:
            TimeoutError: It hung or did not end within `_FINISH_LONGEST_S`, and was killed.
            ValueError: It ended without them.
        """
        try:
            # Closes the pipe: that is how the listener learns that this was all.
            out, _ = self._while_working(
                lambda seconds: self.process.communicate(timeout=seconds),
                idle_s,
                _FINISH_LONGEST_S,
            )
        except subprocess.TimeoutExpired as error:
            self.process.kill()
            raise TimeoutError from error
        last = [content for line in out.splitlines() if (content := told(line)) is not None]
        if not last:
            raise ValueError("the process ended without its last words")
        return last[-1]


def _config_json(config: TransportConfig) -> dict[str, object]:
    content = asdict(config)
    if config.zenoh_config is not None:
        content["zenoh_config"] = str(config.zenoh_config)
    return content
