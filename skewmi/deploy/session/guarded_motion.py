"""A motion that ends where something is met, and then holds still to be measured.

Rest, creep, hold: the arm rests until it is known where; it follows a path until a watch says that
it has met something, or to its end, or until a chunk would be late; it stops on the path and rests
until enough has been measured. The watch looks on until then: what is met in a stop is met, too.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from skewmi.deploy.motion.path_motion import PathMotion
from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.stream import ChunkStream
from skewmi.errors import LimitViolationError
from skewmi.policy_io import Array
from skewmi.trajectory import CYCLE_TICKS, GRID_NS, JointTrajectory

REST_NS = 200_000_000
"""How long the arm is measured at rest before it creeps, ns."""
SETTLING_NS = 500_000_000
"""How long it may take to come to rest after its last command, ns: a servo's delay and damping."""
MEASURED_NS = 400_000_000
"""How long it is measured then, ns."""
LONGEST_HOLD_NS = 4_000_000_000
STILL = 1e-4
"""Largest difference of a joint's two halves of the measured time at rest, rad; the standard
deviation of what is measured counts on top."""


class Watch(Protocol):
    """Judges by commands and measurements whether a creeping arm has met something."""

    touched: bool
    force: float

    def begin(self, q: Array, commanded: Array, direction: Array) -> None:
        """A motion begins from rest at `q`, rad, shape (7,); `direction` in the base frame.

        The watch may learn from its first part what is usual, and notice nothing there: whoever
        begins it sees to it that nothing is in the way of that part.
        """

    def look(self, commands: JointTrajectory, q: Array) -> None:
        """A state has come: commands since the last one, every 4 ms, and what is measured."""


class HoldStill:
    """Rests for a while; the fingers may move meanwhile.

    Args:
        stream: Knows what was sent last.
        duration_ns: For how long.

    Attributes:
        states: That came meanwhile.
    """

    def __init__(self, stream: ChunkStream, duration_ns: int) -> None:
        self._stream, self._duration_ns = stream, duration_ns

    def begin(self, q: Array, state: ArmState) -> None:
        """See `Motion`."""
        del q
        self._end_ns = state.stamp_ns + self._duration_ns
        self.states: list[ArmState] = []

    def is_over(self, state: ArmState) -> bool:
        """Whether the time is over."""
        self.states.append(state)
        return state.stamp_ns >= self._end_ns

    def next_chunk(self, state: ArmState, splice: int) -> JointTrajectory | None:
        """The rest of what was sent: in lock-step time passes only while something is sent."""
        del state
        return rest_of_sent(self._stream, splice)

    def after_sending(self, state: ArmState) -> None:
        """Nothing waits."""


class GuardedMotion:
    """See the module; each `begin` is a new attempt.

    Args:
        motion: To be followed, from where nothing can be met yet; see `Watch.begin`.
        direction: Of the finger, base frame. Shape (3,).
        watch: Says when something is met.
        stream: Knows what was commanded.
        force_limit: More than that ends the run, N.
        peak_force: Of earlier attempts, N.

    Attributes:
        late: Whether the arm was stopped because a chunk would have been late.
        touched: Whether something was met, be it in such a stop.
        peak_force: Largest force that the watch told, in earlier attempts too, N.
        held: States measured at rest at the end.
    """

    def __init__(
        self,
        motion: PathMotion,
        direction: Array,
        watch: Watch,
        stream: ChunkStream,
        force_limit: float,
        peak_force: float = 0.0,
    ) -> None:
        self._motion, self._direction = motion, direction
        self._watch, self._stream, self._force_limit = watch, stream, force_limit
        self.peak_force, self.touched, self.late = peak_force, False, False
        self.held: list[ArmState] = []

    def begin(self, q: Array, state: ArmState) -> None:
        """See `Motion`: from its beginning."""
        self._begun_ns = self._seen_ns = state.stamp_ns
        self._q = q
        self._resting: list[ArmState] = []
        self._cycle, self._creeping, self._rest_ns = 0, False, -1
        self.late, self.touched, self.held = False, False, []

    def is_over(self, state: ArmState) -> bool:
        """Take in a state.

        Raises:
            LimitViolationError: The arm presses too hard.
        """
        if not self._creeping:
            self._resting.append(state)
            if state.stamp_ns - self._begun_ns >= REST_NS:
                self._creeping = True
                mean = np.mean([s.q for s in self._resting], axis=0)
                self._watch.begin(mean, self._q, self._direction)
                self._seen_ns = state.stamp_ns
            return False
        self._look(state)
        if self._rest_ns < 0:
            return False
        if state.stamp_ns >= self._rest_ns + SETTLING_NS:
            self.held.append(state)
            self.held = [s for s in self.held if state.stamp_ns - s.stamp_ns <= MEASURED_NS]
        measured_ns = state.stamp_ns - self._rest_ns - SETTLING_NS
        if measured_ns >= LONGEST_HOLD_NS:
            return True
        return measured_ns >= MEASURED_NS and is_still(np.array([s.q for s in self.held]))

    def next_chunk(self, state: ArmState, splice: int) -> JointTrajectory | None:
        """The next part of the motion, or of the rest."""
        del state
        if not self._creeping:
            return rest_of_sent(self._stream, splice)
        if self._rest_ns < 0 and (self.touched or self._cycle >= self._motion.cycles):
            # What was sent last ends at rest, on the path.
            self._rest_ns = self._stream.rest_ns
        if self._rest_ns >= 0:
            return rest_of_sent(self._stream, splice)
        if splice != CYCLE_TICKS and self._cycle > 0:
            # The stop has begun. It is watched as any other: the finger may press already.
            self.late, self._rest_ns = True, self._stream.rest_ns
            return rest_of_sent(self._stream, splice)
        chunk = self._motion.chunk(self._cycle)
        self._cycle += 1
        return chunk

    def after_sending(self, state: ArmState) -> None:
        """Nothing waits."""

    def _look(self, state: ArmState) -> None:
        ticks = round((state.stamp_ns - self._seen_ns) / GRID_NS)
        points = [self._stream.commanded_point(self._seen_ns + k * GRID_NS) for k in range(ticks)]
        self._seen_ns = state.stamp_ns
        if not points:
            return
        commands = JointTrajectory(*(np.array(part) for part in zip(*points, strict=True)))
        self._watch.look(commands, state.q)
        self.peak_force = max(self.peak_force, self._watch.force)
        self.touched = self.touched or self._watch.touched
        if self._watch.force > self._force_limit:
            raise LimitViolationError(
                "force of the finger tips, N (estimated)", self._watch.force, self._force_limit
            )


def rest_of_sent(stream: ChunkStream, splice: int) -> JointTrajectory:
    """What was sent last, from a sample of it on: a stop to its end, or rest."""
    assert stream.sent is not None
    return stream.sent.trajectory.rest_of(splice, CYCLE_TICKS + 1)


def is_still(q: Array) -> bool:
    """Whether measurements in the order of time, rad, shape (n, 7), are of an arm at rest."""
    half = len(q) // 2
    if half < 2:
        return False
    first, second = q[:half], q[half:]
    scatter = 4.0 * np.sqrt((first.var(axis=0) + second.var(axis=0)) / half)
    return bool((np.abs(second.mean(axis=0) - first.mean(axis=0)) <= STILL + scatter).all())
