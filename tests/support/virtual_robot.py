"""A robot server and a session in virtual time, so that work takes as long as a test says.

Nothing here waits and nothing looks at the computer's clock: what is late is late by arithmetic.
"""

from __future__ import annotations

import threading
from types import SimpleNamespace

import numpy as np
import pytest

from skewmi.deploy.session import stream as stream_module
from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.control_loop import ControlLoop
from skewmi.deploy.session.refused import LateChunkError, check_reference
from skewmi.deploy.session.stream import ChunkStream
from skewmi.deploy.session.timing import CycleTimes
from skewmi.deploy.wire.messages import decode_chunk
from skewmi.robot_models import yumi
from skewmi.trajectory import CYCLE_NS, Array, TrajectoryChunk

LINK_NS = 1_000_000
"""From the robot server to the session, and back, ns."""


class VirtualRobot:
    """A robot server that refuses late chunks, and the session's parts on it.

    Satisfies what `ControlLoop` needs of robot client and observer.

    Args:
        q: Where the arm rests, rad. Shape (7,).
        lead_ns: Of the session.

    Attributes:
        now_ns: The time; both clocks are the same. Tests add to it what work takes.
        held: Where the plan ends, rad. Shape (7,).
        chunks: That were accepted.
        refused: How many came too late.
    """

    def __init__(self, q: Array, lead_ns: int) -> None:
        self.now_ns = 1_000_000_000
        self.held = q.copy()
        self.chunks: list[TrajectoryChunk] = []
        self.refused = 0
        self._untold = False
        self._seen_ns = -1
        self.stream = ChunkStream(
            self.put, yumi.joint_names("right"), (), CycleTimes(), lock_step=False, lead_ns=lead_ns
        )
        self.status = SimpleNamespace(clock_ns=0)
        self.stop = threading.Event()
        self.loop = ControlLoop(
            self,  # type: ignore[arg-type]
            self,  # type: ignore[arg-type]
            self.stream,
            CycleTimes(),
            self.status,  # type: ignore[arg-type]
            self.stop,
            lock_step=False,
        )

    def keeps_time(self, patch: pytest.MonkeyPatch) -> None:
        """Let the stream look at this clock."""
        patch.setattr(stream_module, "time", SimpleNamespace(monotonic_ns=lambda: self.now_ns))

    def put(self, payload: bytes) -> None:
        """A chunk arrives."""
        chunk = decode_chunk(payload)
        if chunk.stamp_ns < self.now_ns + LINK_NS:
            self.refused += 1
            self._untold = True
            return
        self.chunks.append(chunk)
        self.held = chunk.trajectory.q[-1].copy()

    # As robot client.
    def check(self, *, late_is_final: bool) -> None:
        del late_is_final
        if self._untold:
            self._untold = False
            raise LateChunkError("late")

    def check_held(self, q: Array) -> None:
        self.now_ns += 2 * LINK_NS
        check_reference(self.held, q)

    def wait_for_hold(self) -> Array:
        self.now_ns += 20 * CYCLE_NS
        self._untold = False
        return self.held.copy()

    # As observer.
    def check_scene(self) -> None:
        """There is none."""

    def next_state(self) -> ArmState:
        """The newest state, or the next one if that is known."""
        newest = (self.now_ns - LINK_NS) // CYCLE_NS * CYCLE_NS
        if newest <= self._seen_ns:
            newest = self._seen_ns + CYCLE_NS
        self._seen_ns = newest
        self.now_ns = max(self.now_ns, newest + LINK_NS)
        return ArmState(newest, newest + LINK_NS, self._measured(newest), np.zeros(7), 0.01)

    def state_from_now(self) -> ArmState:
        self._seen_ns = max(self._seen_ns, (self.now_ns - LINK_NS) // CYCLE_NS * CYCLE_NS)
        return self.next_state()

    fresh_state = state_from_now

    def _measured(self, stamp_ns: int) -> Array:
        """The arm is where it is commanded."""
        for chunk in reversed(self.chunks):
            if chunk.stamp_ns <= stamp_ns:
                return chunk.trajectory.at(stamp_ns - chunk.stamp_ns).q
        return self.chunks[0].trajectory.q[0] if self.chunks else self.held
