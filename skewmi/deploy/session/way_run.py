"""Carries out a way of the arm, leg by leg, and gives the arm back."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

import numpy as np

from skewmi.deploy.session.carried_out import carried_out
from skewmi.deploy.session.control_loop import ControlLoop
from skewmi.deploy.session.guarded_motion import HoldStill
from skewmi.deploy.session.interrupt import check_interrupt
from skewmi.deploy.session.path_follower import PathFollower
from skewmi.deploy.session.readiness import wait_until_ready
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.deploy.session.states import SessionEvent
from skewmi.deploy.session.status import SessionStatus
from skewmi.deploy.session.stream import ChunkStream
from skewmi.deploy.session.way_plan import Leg
from skewmi.errors import CommandRefusedError
from skewmi.policy_io import Array

MOVED = 1e-3
"""Largest joint distance from where a way was planned to where it begins, rad."""
REACHED = 0.1
"""Largest joint error at the end, rad: friction may hold off an arm that nobody has calibrated."""
SETTLING_NS = 300_000_000
"""How long the arm may take to arrive after its last command, ns."""


class WayRun:
    """One way, from preflight to rest; the parts are as `JointRun`'s.

    Args:
        robot, stream, loop: Of the session.
        follower: Moves the arm along paths.
        status: Told what happens.
        stop: Set from outside to end the run.
        lock_step: Whether the robot waits.
        tell: Told in words what happens.

    Attributes:
        measured: Where the arm was at the end, if it got there, rad. Shape (7,).
    """

    def __init__(
        self,
        robot: RobotClient,
        stream: ChunkStream,
        loop: ControlLoop,
        follower: PathFollower,
        status: SessionStatus,
        stop: threading.Event,
        *,
        lock_step: bool,
        tell: Callable[[str], None],
    ) -> None:
        self._robot, self._stream, self._loop = robot, stream, loop
        self._follower, self._status = follower, status
        self._stop, self._tell = stop, tell
        self._lock_step = lock_step
        self.measured: Array | None = None

    def run(self, legs: Sequence[Leg]) -> list[str]:
        """Carry it out; the arm stays where the last leg ends.

        Returns:
            Why it was stopped, if it was. Whatever ends it, nothing has been sent since.
        """
        return carried_out(
            lambda: self._carry_out(legs),
            self._robot,
            self._status,
            over="the way is over",
            after="after a way of the arm",
            lock_step=self._lock_step,
        )

    def _carry_out(self, legs: Sequence[Leg]) -> None:
        """Raises SkewmiError for whatever ends it early."""
        check_interrupt(self._stop)
        self._robot.meet()
        wait_until_ready(self._robot, self._stop, dry_run=False)
        self._look_at(legs)
        state = self._follower.enter(legs[0].workspace)
        off = np.abs(self._follower.take_place() - legs[0].path.at(0.0)).max()
        if off > MOVED:
            raise CommandRefusedError(
                f"the arm was moved by {off:.3f} rad since the way was planned; start again"
            )
        self._status.fire(SessionEvent.READY, "the whole way is free")
        now = legs[0].workspace
        for number, leg in enumerate(legs):
            if leg.workspace != now:
                state = self._follower.enter(leg.workspace, state)
                now = leg.workspace
            self._tell(f"{leg.words}, in the {leg.workspace} workspace")
            state = self._follower.move(leg.path, 0.0, leg.path.length, state)
            if not number:
                self._status.fire(SessionEvent.AT_START, "the first part of the way is over")
        rest = HoldStill(self._stream, SETTLING_NS)
        state = self._loop.run(rest, self._follower.q, state)
        error = float(np.abs(state.q - self._follower.q).max())
        if error > REACHED:
            raise CommandRefusedError(
                f"the arm stands {error:.3f} rad from where it was led; at most {REACHED} rad are "
                "allowed: is something in its way?"
            )
        self.measured = state.q

    def _look_at(self, legs: Sequence[Leg]) -> None:
        """Work out every motion before any of it is made.

        Raises:
            LimitViolationError: One asks for too much torque, or cannot stop within the limits.
        """
        for leg in legs:
            check_interrupt(self._stop)
            self._follower.look_at(leg.path, leg.workspace)
