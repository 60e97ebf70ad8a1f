"""The stream of chunks from planner to robot server: stamped, checked, sent, timed.

Every chunk is due `lead` after the state that it answers. The lead is the time that planning,
link and jitter may take together; it is the same in lock-step, so that both modes move alike.
If a chunk would come too late, the robot server has begun to brake on the previous one; the stream
then splices further along that braking tail, and the arm goes on without having stood still.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from skewmi.deploy.safety.limits import LimitUsage
from skewmi.deploy.session.timing import CycleTimes
from skewmi.deploy.wire.messages import TrajectoryChunk, encode_chunk
from skewmi.policy_io import Array

GRID_NS = 4_000_000
CYCLE_NS = 20_000_000
"""Planner cycle: 50 Hz."""
CYCLE_TICKS = CYCLE_NS // GRID_NS

SEND_MARGIN_NS = 6_000_000
"""A chunk that would be due sooner than this is not planned: it would probably come too late."""

_HISTORY = 8
"""Chunks that are remembered for comparing measured with commanded motion: 160 ms."""

_WARM_SAMPLES = 120
"""Chunks of the named limit profiles are shorter: 20 ms and a stop of at most 0.4 s."""


class Samples(Protocol):
    """Samples of planned motion, as `planner.PlannedChunk`; each (n, 7)."""

    @property
    def q(self) -> Array: ...
    @property
    def v(self) -> Array: ...
    @property
    def a(self) -> Array: ...


Check = Callable[[Array, Array, Array, tuple[Array, Array, Array], Array], LimitUsage | None]
"""(q, v, a, motion in progress at the first sample, its positions at the three grid steps before)
-> usage; raises LimitViolationError."""


@dataclass
class Sent:
    """What the stream has sent last."""

    stamp_ns: int
    chunk: Samples

    def at(self, stamp_ns: int) -> tuple[Array, Array, Array]:
        """Commanded q, v, a at a time; at rest after the end."""
        index = min(max((stamp_ns - self.stamp_ns) // GRID_NS, 0), len(self.chunk.q) - 1)
        return self.chunk.q[index], self.chunk.v[index], self.chunk.a[index]

    @property
    def rest_ns(self) -> int:
        """When the arm rests if nothing newer comes: the first sample that all others equal."""
        chunk = self.chunk
        moves = (chunk.v != 0.0) | (chunk.a != 0.0) | (chunk.q != chunk.q[-1])
        rows = np.flatnonzero(moves.any(axis=1))
        return self.stamp_ns + (int(rows[-1]) + 1 if rows.size else 0) * GRID_NS


class ChunkStream:
    """Sends chunks in the robot server's time.

    Args:
        put: Publishes an encoded chunk.
        joint_names: Chain order.
        checks: Each judges a chunk before it is sent.
        lock_step: The robot server waits, so nothing is ever late.
        lead_ns: See the module; a multiple of the grid.
    """

    def __init__(
        self,
        put: Callable[[bytes], None],
        joint_names: tuple[str, ...],
        checks: Sequence[tuple[str, Check]],
        times: CycleTimes,
        *,
        lock_step: bool,
        lead_ns: int,
    ) -> None:
        self._put = put
        self._joint_names = joint_names
        self._checks = checks
        self._times = times
        self._lock_step = lock_step
        self._lead_ns = lead_ns
        self._next_ns = 0
        self.sent: Sent | None = None
        self._history: list[Sent] = []
        self.usage = LimitUsage()
        """Largest use of each limit over everything sent, braking tails included."""
        self.missed_cycles = 0
        """Cycles in which no chunk could be sent in time."""

    def warm_up(self) -> None:
        """Lay out messages of every usual length, so that no first one is late by it."""
        for count in range(2, _WARM_SAMPLES):
            _encode(0, self._joint_names, _Rest(np.zeros((count, len(self._joint_names)))))

    def begin(self, q: Array, stamp_ns: int) -> None:
        """Start from rest.

        Args:
            q: Where the robot server holds the arm, rad. Shape (7,).
            stamp_ns: Of the newest state; the first chunk is due `lead` after it.
        """
        rest = _Rest(np.tile(q, (CYCLE_TICKS + 1, 1)))
        self._next_ns = stamp_ns + self._lead_ns
        self.sent = Sent(self._next_ns - CYCLE_NS, rest)
        self._history = [self.sent]

    def due(self, stamp_ns: int, received_ns: int) -> Iterator[int]:
        """Splices of the chunks that are due now that a state has come.

        Usually one per state; two if a state was lost; none right after a long delay.

        Args:
            stamp_ns: Of the state.
            received_ns: When it came, on our monotonic clock.

        Yields:
            For each chunk, the sample of the previous chunk at which it must start. The caller
            sends it with `send` before it asks for the next.
        """
        assert self.sent is not None
        while self._next_ns <= stamp_ns + self._lead_ns:
            late_ns = 0
            if not self._lock_step:
                now_ns = stamp_ns + time.monotonic_ns() - received_ns
                late_ns = max(0, now_ns + SEND_MARGIN_NS - self._next_ns)
            cycles = -(-late_ns // CYCLE_NS)
            self.missed_cycles += cycles
            self._next_ns += cycles * CYCLE_NS
            yield (self._next_ns - self.sent.stamp_ns) // GRID_NS

    def send(self, chunk: Samples) -> None:
        """Check a chunk, and send it with the next stamp.

        Raises:
            LimitViolationError: A check found it wrong; nothing was sent.
            TransportError: The link is closed.
        """
        assert self.sent is not None
        previous = self.sent.at(self._next_ns)
        earlier = np.array([self.sent.at(self._next_ns - age * GRID_NS)[0] for age in (3, 2, 1)])
        for stage, check in self._checks:
            usage = check(chunk.q, chunk.v, chunk.a, previous, earlier)
            if usage is not None:
                self.usage = self.usage.merged(usage)
            self._times.lap(stage)
        self._put(_encode(self._next_ns, self._joint_names, chunk))
        self._times.lap("send")
        self.sent = Sent(self._next_ns, chunk)
        self._history = [*self._history[-_HISTORY:], self.sent]
        self._next_ns += CYCLE_NS

    def commanded(self, stamp_ns: int) -> Array:
        """Joint angles that were commanded for a time not long ago, rad. Shape (7,)."""
        sent = next((s for s in reversed(self._history) if s.stamp_ns <= stamp_ns), None)
        return (self._history[0] if sent is None else sent).at(stamp_ns)[0]


def _encode(stamp_ns: int, joint_names: tuple[str, ...], chunk: Samples) -> bytes:
    times = np.arange(len(chunk.q), dtype=np.int64) * GRID_NS
    return encode_chunk(TrajectoryChunk(stamp_ns, joint_names, times, chunk.q, chunk.v, chunk.a))


@dataclass
class _Rest:
    """An arm that stands still."""

    q: Array

    @property
    def v(self) -> Array:
        return np.zeros_like(self.q)

    @property
    def a(self) -> Array:
        return np.zeros_like(self.q)
