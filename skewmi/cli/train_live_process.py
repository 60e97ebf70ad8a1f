"""The process behind `train_live.LiveTraining`: reads a run's directory and draws what is new.

    python -m skewmi.cli.train_live_process

Its task is a line of JSON on standard input: {"run_dir", "title", "spawn", "web", "connect",
"out"}. It draws until standard input ends, and then once more. Nobody waits for it.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
from pathlib import Path

from skewmi.child import tell_parent
from skewmi.deploy.replay.live_child import come_last, failed, wait_until_idle
from skewmi.deploy.replay.streams import Streams
from skewmi.errors import SkewmiError
from skewmi.evaluation.training_view import TrainingView
from skewmi.train.follow import RunFollower

APPLICATION = "skewmi_training"

PERIOD_S = 0.5
"""Between two looks into the directory."""
_GIVE_UP_S = 8.0
"""After the owner's end: a viewer that takes nothing fills Rerun's buffers, and drawing waits."""


class Drawer:
    """Draws a run from its directory, as far as it is.

    Args:
        run_dir: Of the run.
        streams: Where to.
        title: Of the view.
        live: Follow the newest.
    """

    def __init__(self, run_dir: Path, streams: Streams, title: str, *, live: bool) -> None:
        self._follower = RunFollower(run_dir)
        self._streams, self._title, self._live = streams, title, live
        self._views: list[TrainingView] = []

    def draw(self) -> bool:
        """Draw what is new; whether there was anything."""
        news, facts = self._follower.look(), self._follower.facts()
        if news is None or facts is None or news.nothing:
            return False
        self._views = self._views or [
            TrainingView(stream, facts, self._title, live=self._live)
            for stream in self._streams.all
        ]
        for view in self._views:
            view.draw(news)
        return True


def main() -> int:
    """Draw until standard input ends. Returns the exit code; failures go to stderr."""
    come_last()
    ended = threading.Event()
    task = json.loads(sys.stdin.buffer.readline() or b"{}")

    def wait_for_end() -> None:
        sys.stdin.buffer.read()
        ended.set()
        wait_until_idle(_GIVE_UP_S)
        sys.stderr.write("the viewer took too long\n")
        os._exit(1)

    try:
        streams = Streams.open(task, APPLICATION)
    except (SkewmiError, OSError, RuntimeError, KeyError) as error:
        return failed(error)
    threading.Thread(target=wait_for_end, daemon=True).start()
    with contextlib.suppress(OSError):
        tell_parent(ready=True)
    drawer = Drawer(Path(task["run_dir"]), streams, task["title"], live=True)
    while not ended.is_set():
        drawer.draw()
        ended.wait(PERIOD_S)
    drawer.draw()
    if not streams.finish():
        sys.stderr.write("the viewer did not take the end\n")
        os._exit(1)
    return 0


if __name__ == "__main__":
    sys.exit(main())
