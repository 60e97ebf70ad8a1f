"""The stream of chunks from planner to robot server: stamped, checked, sent, timed.

Every chunk is due `lead` after the state that it answers. The lead is the time that planning,
link and jitter may take together; it is the same in lock-step, so that both modes move alike.
If a chunk would come too late, the robot server has begun to brake on the previous one; the stream
then splices further along that braking tail, and the arm goes on without having stood still.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from skewmi.deploy.safety.checks import Check
from skewmi.deploy.safety.limits import LimitUsage
from skewmi.deploy.session.timing import CycleTimes
from skewmi.deploy.wire.messages import encode_chunk
from skewmi.trajectory import (
    CYCLE_NS,
    CYCLE_TICKS,
    GRID_NS,
    Array,
    JointPoint,
    JointTrajectory,
    TrajectoryChunk,
)

SEND_MARGIN_NS = 6_000_000
"""A chunk that would be due sooner than this is not planned: it would probably come too late."""

_HISTORY = 16
"""Chunks that are remembered for comparing measured with commanded motion: 320 ms, more than the
longest lead and the longest delay of an arm that is reckoned with."""

_WARM_SAMPLES = 120
"""Chunks of the named limit profiles are shorter: 20 ms and a stop of at most 0.4 s."""


def lead_of(lead_ms: float, cycle_ns: int) -> int:
    """From a state to the motion that answers it, ns.

    Args:
        lead_ms: As the user has it, ms.
        cycle_ns: Of the robot: one with a cycle of its own may tell its state by so much later
            than the grid, in whole steps.
    """
    late_ns = 0 if GRID_NS % cycle_ns == 0 else -(-cycle_ns // GRID_NS) * GRID_NS
    return round(lead_ms * 1e6) + late_ns


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
        self.sent: TrajectoryChunk | None = None
        """The newest chunk; not None after `begin`."""
        self._history: list[TrajectoryChunk] = []
        self.usage = LimitUsage()
        """Largest use of each limit over everything sent, braking tails included."""
        self.missed_cycles = 0
        """Cycles in which no chunk could be sent in time."""

    @property
    def lead_s(self) -> float:
        """Time from a state to the motion that answers it, s."""
        return self._lead_ns / 1e9

    def warm_up(self) -> None:
        """Lay out messages of every usual length, so that no first one is late by it."""
        for count in range(2, _WARM_SAMPLES):
            rest = JointTrajectory.resting(np.zeros(len(self._joint_names)), count)
            encode_chunk(TrajectoryChunk.of(0, self._joint_names, rest))

    def begin(self, q: Array, stamp_ns: int) -> None:
        """Start from rest.

        Args:
            q: Where the robot server holds the arm, rad. Shape (7,).
            stamp_ns: Of the newest state; the first chunk is due `lead` after the cycle it is of
                has begun.
        """
        # A robot whose own cycle is not the grid's tells its state a little late in each of ours.
        self._next_ns = stamp_ns - stamp_ns % CYCLE_NS + self._lead_ns
        rest = JointTrajectory.resting(q, CYCLE_TICKS + 1)
        self.sent = TrajectoryChunk.of(self._next_ns - CYCLE_NS, self._joint_names, rest)
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

    def send(self, samples: JointTrajectory) -> None:
        """Check motion, and send it with the next stamp.

        Raises:
            LimitViolationError: A check found it wrong; nothing was sent.
            TransportError: The link is closed.
        """
        assert self.sent is not None
        previous = _commanded_by(self.sent, self._next_ns)
        earlier = np.array(
            [_commanded_by(self.sent, self._next_ns - age * GRID_NS).q for age in (3, 2, 1)]
        )
        for stage, check in self._checks:
            usage = check(samples, previous, earlier)
            if usage is not None:
                self.usage = self.usage.merged(usage)
            self._times.lap(stage)
        chunk = TrajectoryChunk.of(self._next_ns, self._joint_names, samples)
        self._put(encode_chunk(chunk))
        self._times.lap("send")
        self.sent = chunk
        self._history = [*self._history[-_HISTORY:], self.sent]
        self._next_ns += CYCLE_NS

    def commanded(self, stamp_ns: int) -> Array:
        """Joint angles that were commanded for a time not long ago, rad. Shape (7,)."""
        return self.commanded_point(stamp_ns).q

    def commanded_point(self, stamp_ns: int) -> JointPoint:
        """Joint motion that was commanded for a time not long ago."""
        newest = (chunk for chunk in reversed(self._history) if chunk.stamp_ns <= stamp_ns)
        return _commanded_by(next(newest, self._history[0]), stamp_ns)

    @property
    def rest_ns(self) -> int:
        """When the arm rests if nothing newer is sent, in the robot server's clock."""
        assert self.sent is not None
        return self.sent.stamp_ns + self.sent.trajectory.rest_ns


def _commanded_by(chunk: TrajectoryChunk, stamp_ns: int) -> JointPoint:
    return chunk.trajectory.at(stamp_ns - chunk.stamp_ns)
