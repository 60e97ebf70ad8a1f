"""How regularly a run's messages were sent, and how long before its time each command was.

From the stamps of the messages (the robot server's clock) and the wall clocks of their senders,
which every attachment and every recorded message has.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skewmi.deploy.replay.buffers import NS_PER_S
from skewmi.deploy.replay.data import Array, Series
from skewmi.deploy.wire import topics
from skewmi.trajectory import CYCLE_NS, GRID_NS

NS_PER_MS = 1e6
_PAUSE_NS = 1_000_000_000
"""Between two messages so far apart nobody meant to send any."""


@dataclass(frozen=True)
class Regular:
    """Messages that are sent in a fixed rhythm."""

    topic: str
    label: str
    """For people."""
    period_ms: float
    """As meant."""


REGULAR = (
    Regular(topics.YUMI_TRAJECTORY.name, "commands", CYCLE_NS / NS_PER_MS),
    Regular(topics.YUMI_JOINT_STATES.name, "joint states", CYCLE_NS / NS_PER_MS),
    Regular(topics.YUMI_CONTROLLER_STATE.name, "robot's cycles", GRID_NS / NS_PER_MS),
)


def interval_path(label: str) -> str:
    """Entity of the time between two messages of a kind."""
    return f"/timing/intervals/{label.replace(' ', '_').replace(chr(39), '')}"


class TimingBuffer:
    """Takes stamps and times of sending in, and hands out what they tell.

    Args:
        lock_step: Robot and session wait for each other: nothing can be late.
    """

    def __init__(self, *, lock_step: bool) -> None:
        self._lock_step = lock_step
        self._new: dict[str, list[tuple[int, int]]] = {kind.topic: [] for kind in REGULAR}
        self._last: dict[str, tuple[int, int]] = {}
        self._commands: list[tuple[int, int]] = []
        self._states: list[tuple[int, int]] = []

    def add(self, topic: str, stamp_ns: int, sent_ns: int) -> None:
        """A message of a topic.

        Args:
            topic: Its name.
            stamp_ns: The robot server's clock.
            sent_ns: The wall clock of its sender.
        """
        if topic not in self._new:
            return
        self._new[topic].append((stamp_ns, sent_ns))
        if topic == topics.YUMI_TRAJECTORY.name:
            self._commands.append((stamp_ns, sent_ns))
        elif topic == topics.YUMI_JOINT_STATES.name:
            self._states.append((stamp_ns, sent_ns))

    def take_intervals(self, origin_ns: int) -> dict[str, Series]:
        """Time between each message and the one before it, ms, by label of its kind."""
        found = {}
        for kind in REGULAR:
            new, self._new[kind.topic] = self._new[kind.topic], []
            last = self._last.get(kind.topic)
            rows = np.array([*([] if last is None else [last]), *new], dtype=np.int64)
            if not new:
                continue
            self._last[kind.topic] = new[-1]
            stamps_ns, sent_ns = rows.T
            between_ns = np.diff(sent_ns)
            # A state that is told again, while time stands still, is not late.
            kept = (between_ns < _PAUSE_NS) & (between_ns >= 0) & (np.diff(stamps_ns) > 0)
            if kept.any():
                times = (stamps_ns[1:][kept] - origin_ns) / NS_PER_S
                values = between_ns[kept, None] / NS_PER_MS
                found[kind.label] = Series(times, (kind.label,), values)
        return found

    def take_spare(self, origin_ns: int, *, final: bool) -> Series:
        """How long before its first sample is due each command was sent, ms; negative if too late.

        Args:
            origin_ns: Of the time axis.
            final: Nothing more will come; else a command waits for the state after it.
        """
        name = ("sent before due",)
        if self._lock_step or not self._states:
            self._commands = [] if self._lock_step else self._commands
            return Series(np.zeros(0), name, np.zeros((0, 1)))
        newest_ns = self._states[-1][1]
        ready = [c for c in self._commands if final or c[1] <= newest_ns]
        self._commands = self._commands[len(ready) :]
        states = np.array(self._states, dtype=np.int64)
        self._states = self._states[-1:] if not self._commands else self._states[-200:]
        commands = np.array(ready, dtype=np.int64).reshape(-1, 2)
        before = np.searchsorted(states[:, 1], commands[:, 1], side="right") - 1
        commands, before = commands[before >= 0], before[before >= 0]
        # The robot server's clock goes on from the newest state that had been sent.
        clock_ns = states[before, 0] + commands[:, 1] - states[before, 1]
        spare: Array = (commands[:, 0] - clock_ns)[:, None] / NS_PER_MS
        return Series((commands[:, 0] - origin_ns) / NS_PER_S, name, spare)
