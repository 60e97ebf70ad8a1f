"""The process behind `live.LiveView`: subscribes to what is shown and draws what comes in Rerun.

    python -m skewmi.deploy.replay.live_process

Standard input and output as in `recording.listener`: the task is {"config", "believed", "metadata",
"title", "spawn", "web", "connect", "out"}. A line a second tells the owner that this process is not
stuck; the counts come last.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time

from skewmi.child import tell_parent
from skewmi.deploy.recording.listener import Counts, Input, listen
from skewmi.deploy.replay.assembler import RunAssembler
from skewmi.deploy.replay.data import Subject
from skewmi.deploy.replay.live_child import come_last, failed, wait_until_idle
from skewmi.deploy.replay.streams import Streams
from skewmi.deploy.replay.view import RunView
from skewmi.deploy.wire.topics import TOPICS, YUMI_CONTROLLER_STATE
from skewmi.deploy.wire.transport import Link
from skewmi.errors import SkewmiError

APPLICATION = "skewmi_live"

PERIOD_S = 0.1
"""Between two looks at what has come. Each is drawn with one call per entity, however much came."""

ALIVE_S = 1.0
"""Between two signs of life."""

_SHOWN = tuple(topic for topic in TOPICS if topic != YUMI_CONTROLLER_STATE)
"""What is executed is told in every cycle, and can be seen in the joint states: not worth the time
of a process that comes last."""

_GIVE_UP_S = 5.0
"""After the owner's end: a viewer that takes nothing for minutes fills Rerun's buffers, and
drawing waits for it for ever."""


def _show(source: Input, streams: Streams) -> tuple[Counts, RunAssembler]:
    task = source.task
    subject = Subject.from_metadata(task["metadata"], "the run's description")
    with Link.open(source.transport(), f"skewmi_live_{os.getpid()}") as link:
        assembler = RunAssembler(subject)
        views = [RunView(stream, subject, task["title"], live=True) for stream in streams.all]

        def draw(*, final: bool = False) -> None:
            run = assembler.take(final=final)
            if run is not None:
                for view in views:
                    view.draw(run)

        threading.Thread(target=_tell_alive, daemon=True).start()
        counts = listen(
            link,
            source,
            PERIOD_S,
            on_sample=lambda topic, sample: assembler.feed(
                topic.name, sample.payload, sample.source_time_ns
            ),
            on_round=draw,
            on_line=lambda content: None,
            topics=_SHOWN,
        )
        draw(final=True)
    return counts, assembler


def _tell_alive() -> None:
    with contextlib.suppress(OSError):  # the owner is gone
        while True:
            tell_parent(alive=True)
            time.sleep(ALIVE_S)


def main() -> int:
    """Draw until standard input ends. Returns the exit code; failures go to stderr."""
    come_last()
    opened: list[Streams] = []

    def give_up() -> None:
        wait_until_idle(_GIVE_UP_S)
        for streams in opened:
            streams.finish()
        os._exit(1)

    source = Input.open(on_end=give_up)
    try:
        streams = Streams.open(source.task, APPLICATION)
        opened.append(streams)
        counts, assembler = _show(source, streams)
    except (SkewmiError, OSError, RuntimeError) as error:
        return failed(error)
    taken = streams.finish()
    told = {"malformed": assembler.malformed, "taken": taken, "broken": streams.broken}
    tell_parent(**counts.as_dict(), **told)
    if not taken:
        # Tidying up would wait for whoever takes nothing more.
        os._exit(0)
    return 0


if __name__ == "__main__":
    sys.exit(main())
