"""What has come of a run and not been handed out yet: executed command, and named numbers."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from skewmi.deploy.replay.data import REGULAR_S, Array, Motion, Series, no_motion
from skewmi.deploy.wire.messages import JointStates
from skewmi.robot_models.base_frame import NOMINAL_BASE, BaseFrame
from skewmi.trajectory import TrajectoryChunk

NS_PER_S = 1e9

_SET_BACK_NS = 1_000_000_000
"""A stamp older than the last one by more than this is of another clock, not an overlap."""


class CommandBuffer:
    """The command as executed: each chunk until the next one is due, the last to its end.

    A chunk that the robot server has refused is not executed: the one before it is followed on,
    into its tail. The refusal is told before the chunk is due, so that nothing of it is shown if
    `advance` does not go further than what has been heard.
    """

    def __init__(self, base: BaseFrame = NOMINAL_BASE) -> None:
        self._base = base
        self._waiting: deque[TrajectoryChunk] = deque()
        self._chunk: TrajectoryChunk | None = None
        self._shown = 0
        self._times: list[NDArray[np.int64]] = []
        self._parts: list[Array] = []
        self._last_ns: int | None = None
        self._last: tuple[int, Array] | None = None
        self.stamps_ns: list[int] = []
        """Of the chunks since the last `take`."""

    def add(self, chunk: TrajectoryChunk) -> None:
        """A newer chunk."""
        self._waiting.append(chunk)
        self.stamps_ns.append(chunk.stamp_ns)

    def refuse(self, stamp_ns: int) -> None:
        """The robot server does not execute the chunk with this stamp."""
        for chunk in reversed(self._waiting):
            if chunk.stamp_ns == stamp_ns:
                self._waiting.remove(chunk)
                return

    def advance(self, now_ns: int | None) -> None:
        """The arm has followed the newest chunk up to a time; None: to its end."""
        while self._waiting and (now_ns is None or self._waiting[0].stamp_ns <= now_ns):
            chunk = self._waiting.popleft()
            self._show(before_ns=chunk.stamp_ns)
            self._chunk, self._shown = chunk, 0
        self._show(before_ns=None if now_ns is None else now_ns + 1)

    def take(self, origin_ns: int) -> Motion:
        """Everything shown since the last call."""
        self.stamps_ns = []
        if not self._times:
            return no_motion()
        time_ns = np.concatenate(self._times)
        q, v, a = np.concatenate(self._parts, axis=1)
        last_ns, last_a = (int(time_ns[0]), a[0]) if self._last is None else self._last
        # An interrupted stream resumes with stamps beyond the last chunk's end: no jerk across it.
        step_s = np.diff(time_ns, prepend=last_ns) / NS_PER_S
        regular = (step_s > 0) & (step_s < REGULAR_S)
        jerk = np.diff(a, axis=0, prepend=last_a[None]) / np.where(regular, step_s, np.inf)[:, None]
        self._times, self._parts = [], []
        self._last = int(time_ns[-1]), a[-1]
        return Motion((time_ns - origin_ns) / NS_PER_S, q, v, a, jerk, self._base)

    def _show(self, before_ns: int | None) -> None:
        chunk = self._chunk
        if chunk is None:
            return
        due_ns = chunk.stamp_ns + chunk.time_from_start_ns
        end = len(due_ns) if before_ns is None else int(np.searchsorted(due_ns, before_ns))
        start = self._shown
        if self._last_ns is not None and chunk.stamp_ns > self._last_ns - _SET_BACK_NS:
            # A chunk that came too late does not change what the arm has done by then.
            start = max(start, int(np.searchsorted(due_ns, self._last_ns, side="right")))
        if start >= end:
            return
        self._times.append(due_ns[start:end])
        shown = chunk.trajectory.part(slice(start, end))
        self._parts.append(np.stack([shown.q, shown.v, shown.a]))
        self._last_ns, self._shown = int(due_ns[end - 1]), end


class SeriesBuffer:
    """Numbers of the messages that name the same things as the first one.

    Args:
        only: Names that count; all by default.
        quantity: `position`, `velocity` or `effort`; messages without it are passed over.
    """

    def __init__(self, only: tuple[str, ...] | None = None, quantity: str = "position") -> None:
        self._only, self._quantity = only, quantity
        self._names: tuple[str, ...] = ()
        self._rows: list[JointStates] = []

    def add(self, states: JointStates) -> None:
        if not len(getattr(states, self._quantity)):
            return
        self._names = self._names or states.names
        if states.names == self._names:
            self._rows.append(states)

    def take(self, origin_ns: int) -> Series:
        """Everything added since the last call."""
        rows, self._rows = self._rows, []
        columns = [i for i, n in enumerate(self._names) if self._only is None or n in self._only]
        return Series(
            np.array([(row.stamp_ns - origin_ns) / NS_PER_S for row in rows]),
            tuple(self._names[i] for i in columns),
            np.array([getattr(row, self._quantity)[columns] for row in rows]).reshape(
                len(rows), len(columns)
            ),
        )
