"""Whether this computer keeps the pace of a robot in real time, seen before anything moves."""

from __future__ import annotations

import time
from collections.abc import Callable

from skewmi.deploy.realtime import hot_loop
from skewmi.deploy.session.observer import Observer
from skewmi.deploy.session.scene_states import StaleStateError
from skewmi.deploy.session.timing import BUSY_ADVICE
from skewmi.errors import SkewmiError

WATCHED_S = 1.0
"""How long is watched."""

ENOUGH = 0.5
"""Part of the allowed age of a state that a computer may need in this time; the run is longer."""


class TooBusyError(SkewmiError):
    """States come too far apart for this robot to be commanded in real time."""


def check_steadiness(observer: Observer, work: Callable[[], object]) -> None:
    """Watch states come while doing what every cycle does; nothing is sent.

    With a real-time priority that is granted nothing is watched: others do not delay us then.

    Args:
        observer: Of the robot that is to be commanded.
        work: What every cycle does.

    Raises:
        TooBusyError: They come too far apart.
    """
    with hot_loop(priority=True) as granted:
        if "SCHED_FIFO" in granted:
            return
        gap_s = largest_gap_s(observer, work, WATCHED_S)
    allowed_s = ENOUGH * observer.max_age_s
    if gap_s > allowed_s:
        raise TooBusyError(
            f"this computer is too busy for real time: states of the robot came up to "
            f"{1e3 * gap_s:.0f} ms apart within {WATCHED_S:g} s, {1e3 * allowed_s:.0f} ms are "
            f"allowed; {BUSY_ADVICE}"
        )


def largest_gap_s(observer: Observer, work: Callable[[], object], duration_s: float) -> float:
    """The longest time between two states, s.

    Args:
        observer: Where they come from.
        work: Done after each.
        duration_s: How long to look, s.
    """
    observer.forget()
    longest_ns, end_ns = 0, time.monotonic_ns() + round(1e9 * duration_s)
    last_ns = time.monotonic_ns()
    while last_ns < end_ns:
        try:
            observer.next_state()
        except StaleStateError:
            # None came for so long that the arm would have stopped.
            return observer.max_age_s
        now_ns = time.monotonic_ns()
        longest_ns, last_ns = max(longest_ns, now_ns - last_ns), now_ns
        work()
    return longest_ns / 1e9
