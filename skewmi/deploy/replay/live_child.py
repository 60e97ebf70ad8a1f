"""What all live views have in common: a process that draws, told where to, and never waited for.

`live.LiveView` shows a deployment and `cli.train_live.LiveTraining` a training. Each has a child
that opens `Streams` to the places of its task and draws until its standard input ends; whatever
becomes of it, what is shown goes on as without.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

from skewmi.child_process import WORK_S, ChildProcess, ChildStartError
from skewmi.deploy.replay.live_options import LiveOptions
from skewmi.errors import ConfigurationError

HUNG = "the live view hung and was ended"
_NICENESS = 10
"""Drawing waits for what is shown; a viewer that is spawned inherits it."""
LONGEST_S = 50.0
"""How long drawing may go on after the end of what is shown."""

Child = TypeVar("Child", bound=ChildProcess)


class DrawnByChild(ABC, Generic[Child]):
    """A live view; a context manager that ends it.

    Args:
        child: Draws.
    """

    def __init__(self, child: Child) -> None:
        self._child = child

    @abstractmethod
    def close(self) -> object:
        """End the view; what it lacks. Safe to call twice; neither raises nor waits for long."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _ended_early(self) -> str:
        return f"the live view ended early: {self._child.reason()}"


@contextmanager
def starting() -> Iterator[None]:
    """Tell why a view does not start.

    Raises:
        ConfigurationError: It cannot be shown there.
    """
    try:
        yield
    except ChildStartError as error:
        raise ConfigurationError(f"no live view: {error}") from error


def places(options: LiveOptions, title: str) -> dict[str, Any]:
    """What `Streams.open` needs of a child's task.

    Args:
        options: Where to show it.
        title: What to call it.
    """
    return {
        "title": title,
        "spawn": options.spawn and options.web_ports is None,
        "web": options.web_ports,
        "connect": options.connect,
        "out": None if options.out is None else str(options.out),
    }


def come_last() -> None:
    """In the child: leave processor time to what is shown."""
    with contextlib.suppress(OSError):
        os.nice(_NICENESS)


def wait_until_idle(idle_s: float) -> None:
    """In the child: wait until nothing has been done for a while, or for `LONGEST_S`.

    A viewer that takes nothing leaves this process waiting; a busy computer only makes it slow.

    Args:
        idle_s: For how long, s.
    """
    until = time.monotonic() + LONGEST_S
    while time.monotonic() < until:
        before = time.process_time()
        time.sleep(idle_s)
        if time.process_time() - before < WORK_S:
            return


def failed(error: Exception) -> int:
    """In the child: tell in one line why nothing is drawn. Returns the exit code."""
    sys.stderr.write(f"{' '.join(str(error).split())}\n")
    return 1
