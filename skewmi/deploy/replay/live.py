"""Shows a deployment in Rerun while it happens, from a process of its own.

Nothing that becomes of the view reaches the deployment: if its process dies, the run goes on
without; if it is stuck, it is killed, because a subscriber that takes nothing would in the end
slow those who send. A viewer that dies or hangs takes part of the picture with it, nothing else.
"""

from __future__ import annotations

import os
import select
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

from skewmi.child import told
from skewmi.deploy.recording.listener import strangers_told
from skewmi.deploy.recording.listener_process import ListenerProcess
from skewmi.deploy.replay.live_child import HUNG, DrawnByChild, places, starting
from skewmi.deploy.replay.live_options import LiveOptions
from skewmi.deploy.replay.rerun_file import is_whole
from skewmi.deploy.wire.senders import Stranger
from skewmi.deploy.wire.transport import TransportConfig

_STUCK_S = 5.0
"""For so long the process may do nothing and tell nothing; it gives a sign of life every second."""

_CLOSE_LONGEST_S = 60.0

_KEPT_BYTES = 65_536
"""Of what the process has said last: its last words name strangers, a bounded number."""


class LiveView(DrawnByChild[ListenerProcess]):
    """A live view of all topics of a link; a context manager that ends it; `start` makes one.

    Args:
        listener: Draws.
        file: That it writes, if it does.

    Attributes:
        strangers: Whose messages were left out; known once it is closed.
        file_is_whole: Whether the file has everything that was drawn; known once it is closed.
    """

    def __init__(self, listener: ListenerProcess, file: Path | None = None) -> None:
        super().__init__(listener)
        self._file = file
        self._said = b""
        self._stuck = False
        self._whole = True
        self._notes: list[str] | None = None
        self.strangers: tuple[Stranger, ...] = ()
        self.file_is_whole = False
        self._watcher = threading.Thread(target=self._watch, name="skewmi-live", daemon=True)

    @classmethod
    def start(
        cls,
        options: LiveOptions,
        config: TransportConfig,
        metadata: Mapping[str, str],
        title: str,
        believed: Mapping[str, Sequence[str]],
    ) -> Self:
        """Open a view, and watch over the process that draws it.

        Args:
            options: Where to show it.
            config: How to reach the robot server.
            metadata: What the run is about; see `reader.run_metadata`.
            title: What to call it.
            believed: Whose messages to show: hexadecimal global ids by topic.

        Raises:
            ConfigurationError: It cannot be shown there; nothing has moved yet.
        """
        task = {
            "believed": believed,
            "metadata": dict(metadata),
            **places(options, title),
        }
        with starting():
            listener = ListenerProcess.start("skewmi.deploy.replay.live_process", config, task)
        view = cls(listener, options.out)
        view._watcher.start()
        return view

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._child.process.pid

    def believe(self, believed: Mapping[str, Sequence[str]]) -> None:
        """Show the messages of these senders from now on, and nobody else's; see `start`."""
        self._child.write({"believed": believed})

    def close(self) -> list[str]:
        """End the view; what it lacks. Safe to call twice; neither raises nor waits for long."""
        if self._notes is None:
            self._child.let_finish()
            # The watcher kills it if it hangs.
            self._watcher.join(_CLOSE_LONGEST_S)
            if self._watcher.is_alive():
                self._kill()
                self._watcher.join()
            self._notes = self._judge()
            # Of a child that was killed, or that gave a viewer up, only the file itself tells.
            self.file_is_whole = self._whole and self._file is not None and is_whole(self._file)
        return self._notes

    def _watch(self) -> None:
        """Read what the process says until it ends; kill it if it says nothing."""
        assert self._child.process.stdout is not None
        said = self._child.process.stdout.fileno()
        while True:
            ready, _, _ = select.select([said], [], [], _STUCK_S)
            if not ready:
                if self._child.is_working():
                    continue
                self._kill()
                return
            words = os.read(said, 4096)
            if not words:
                return
            self._said = (self._said + words)[-_KEPT_BYTES:]

    def _kill(self) -> None:
        self._stuck = True
        self._child.process.kill()

    def _judge(self) -> list[str]:
        if self._stuck:
            self._child.process.wait()
            return [HUNG]
        summary = next(filter(None, map(told, reversed(self._said.splitlines()))), {})
        try:
            missed, taken = int(summary["missed"]), bool(summary["taken"])
            broken = str(summary["broken"])
            self.strangers = strangers_told(summary)
        except (ValueError, KeyError, TypeError):
            return [self._ended_early()]
        self._child.process.wait()
        notes = [f"the live view lacks {missed} messages"] if missed else []
        if broken:
            self._whole = False
            notes.append(f"the live view's file is not whole: {broken}")
        elif not taken:
            notes.append("the live view's end was not taken by the viewer")
        return notes
