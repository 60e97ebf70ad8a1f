"""Carries out a motion of the joints that is known beforehand, in a workspace made for it.

Preflight, the way to where the motion begins, the motion, and the way back: everything is checked
before the arm is moved, every chunk once more before it is sent, and every chunk ends at rest.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

import numpy as np

from skewmi.deploy.motion.path_motion import PathMotion
from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.safety.checks import Check
from skewmi.deploy.safety.limits import SPLICE_TOLERANCE
from skewmi.deploy.session.approach import Approach
from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.carried_out import carried_out
from skewmi.deploy.session.control_loop import ControlLoop
from skewmi.deploy.session.interrupt import check_interrupt
from skewmi.deploy.session.observer import Observer
from skewmi.deploy.session.readiness import wait_until_ready
from skewmi.deploy.session.refused import LateChunkError, OutOfStepError, given_up
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.deploy.session.states import SessionEvent
from skewmi.deploy.session.status import SessionStatus
from skewmi.deploy.session.stream import ChunkStream
from skewmi.policy_io import Array
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import CYCLE_TICKS, JointPoint, JointTrajectory

ATTEMPTS = 3
"""How often the motion is begun; again after a chunk that came too late."""

_NEVER_NS = 1 << 62
_AT_ONCE = 10
"""Samples that the guard looks at together."""


class JointRun:
    """One motion, from preflight to rest.

    Args:
        robot: To arm.
        workspace: Name of the one to ask for.
        observer: Where states come from.
        stream: Where chunks go to.
        loop: Carries motions out.
        approach: Moves the arm to where the motion begins, and back.
        stages: Checks that every chunk has to pass.
        limits: That motion is planned with.
        status: Told what happens.
        stop: Set from outside to end the run.
        lock_step: Whether the robot waits.
        tell: Told in words what happens.
    """

    def __init__(
        self,
        robot: RobotClient,
        workspace: str,
        observer: Observer,
        stream: ChunkStream,
        loop: ControlLoop,
        approach: Approach,
        stages: Sequence[tuple[str, Check]],
        limits: JointLimits,
        status: SessionStatus,
        stop: threading.Event,
        *,
        lock_step: bool,
        tell: Callable[[str], None],
    ) -> None:
        self._robot, self._workspace = robot, workspace
        self._observer, self._stream, self._loop = observer, stream, loop
        self._approach, self._stages, self._limits = approach, stages, limits
        self._status, self._stop, self._tell = status, stop, tell
        self._lock_step = lock_step

    def run(self, trajectory: JointTrajectory) -> list[str]:
        """Carry it out; the arm goes back to where it was.

        Args:
            trajectory: From rest to rest, within the limits.

        Returns:
            Why it was stopped, if it was; nothing if it was not. Whatever ends it, nothing has been
            sent since.
        """
        return carried_out(
            lambda: self._carry_out(trajectory),
            self._robot,
            self._status,
            over="the motion is over",
            after="after a motion of the joints",
            lock_step=self._lock_step,
        )

    def _carry_out(self, trajectory: JointTrajectory) -> None:
        """Raises SkewmiError for whatever ends it early."""
        check_interrupt(self._stop)
        self._robot.meet()
        wait_until_ready(self._robot, self._stop, dry_run=False)
        # Looked at before arming: who holds an arm must not be silent for as long as that takes.
        motion = PathMotion(trajectory, self._limits)
        self._check(motion)
        q_seen = self._resting()
        self._check_ways(q_seen, trajectory)
        self._robot.arm(workspace=self._workspace)
        q_before = self._resting()
        # Nobody can have moved the arm by more than a little meanwhile.
        if (q_before != q_seen).any():
            self._check_ways(q_before, trajectory)
        self._status.fire(SessionEvent.READY, "the whole motion is free")
        state = self._observer.fresh_state()
        self._tell("moving to where the motion begins")
        state = self._approach.run(trajectory.q[0], q_before, state)
        self._status.fire(SessionEvent.AT_START, "the arm rests where the motion begins")
        self._tell(f"moving for {trajectory.duration_s:.0f} s")
        state = self._follow(motion, state)
        self._tell("moving back")
        self._approach.run(q_before, trajectory.q[-1], state)

    def _resting(self) -> Array:
        """Where the robot server holds the arm, rad."""
        description = self._robot.describe()
        self._status.clock_ns = description.clock_ns
        return np.array(description.commanded_position)

    def _check_ways(self, q: Array, trajectory: JointTrajectory) -> None:
        """Look at the way to a motion, and at the way back, which may lead out where it leads in.

        Args:
            q: Where the arm rests, rad. Shape (7,).
            trajectory: Of the motion.
        """
        for start, goal in ((q, trajectory.q[0]), (trajectory.q[-1], q)):
            self._check(StartMotion(start, goal, self._limits))

    def _check(self, motion: PathMotion | StartMotion) -> None:
        """Look at a motion before any of it is sent.

        Raises:
            LimitViolationError: It breaks a limit, leaves the workspace, leads through something,
                or asks for too much torque.
        """
        stages, rows = dict(self._stages), motion.trajectory
        for cycle in range(motion.cycles):
            check_interrupt(self._stop)
            # As it will be sent. A workspace holds from inside: a chunk begins on a sample of the
            # one before, so that none can begin outside once the hand has come in.
            first = cycle * CYCLE_TICKS
            before = JointPoint(rows.q[first], rows.v[first], rows.a[first])
            earlier = rows.q[np.maximum(np.arange(first - 3, first), 0)]
            stages["check"](motion.chunk(cycle), before, earlier)
        for first in range(0, len(rows), _AT_ONCE):
            check_interrupt(self._stop)
            part = rows.part(slice(first, first + _AT_ONCE + 1))
            start = JointPoint(part.q[0], np.zeros(7), np.zeros(7))
            stages["guard"](part, start, start.q[None])

    def _follow(self, motion: PathMotion, state: ArmState) -> ArmState:
        """Carry the motion out from its beginning.

        Returns:
            The newest state, with the arm at rest at its end.

        Raises:
            CommandRefusedError: It came too late `ATTEMPTS` times.
            SkewmiError: Whatever else ends it.
        """
        q = motion.trajectory.q[0]
        last: OutOfStepError | None = None
        for attempt in range(ATTEMPTS):
            if attempt:
                why = "a chunk came too late" if last is None else str(last)
                self._tell(f"{why}: the motion begins anew")
                state = self._approach.run(motion.trajectory.q[0], q, state)
                q = motion.trajectory.q[0]
            way, last = KnownMotion(motion, self._stream), None
            try:
                state = self._loop.run(way, q, state)
                if not way.late:
                    return state
                q, state = self._loop.coast(state)
            except OutOfStepError as error:
                last = error
                q, state = self._loop.recover(error)
                if isinstance(error, LateChunkError) and way.all_sent and _at_end(q, motion):
                    # What came too late was rest: the arm has followed the motion to its end.
                    return state
        raise given_up("motions", ATTEMPTS, last)


def _at_end(q: Array, motion: PathMotion) -> bool:
    """Whether an arm that is held at `q`, rad, shape (7,), is held where a motion ends."""
    return bool(np.abs(q - motion.trajectory.q[-1]).max() <= SPLICE_TOLERANCE[0])


class KnownMotion:
    """A `PathMotion` for the control loop; each `begin` is a new attempt.

    Args:
        motion: What to do.
        stream: Knows when the arm rests.

    Attributes:
        late: Whether the attempt was given up because a chunk would have been late. What only rests
            after the motion's end may be.
    """

    def __init__(self, motion: PathMotion, stream: ChunkStream) -> None:
        self._motion = motion
        self._stream = stream
        self._cycle, self.late = 0, False

    @property
    def all_sent(self) -> bool:
        """Whether the motion's last chunk has been sent in the present attempt."""
        return self._cycle >= self._motion.cycles

    def begin(self, q: Array, state: ArmState) -> None:
        """See `Motion`: from its beginning."""
        del q, state
        self._cycle, self._rest_ns, self.late = 0, _NEVER_NS, False

    def is_over(self, state: ArmState) -> bool:
        """Whether the arm has followed it to its end."""
        if self.all_sent:
            # Chunks that rest follow: in lock-step time passes only while something is sent.
            self._rest_ns = min(self._rest_ns, self._stream.rest_ns)
        return state.stamp_ns >= self._rest_ns

    def next_chunk(self, state: ArmState, splice: int) -> JointTrajectory | None:
        """The next part of the motion."""
        del state
        if splice != CYCLE_TICKS and self._cycle > 0 and not self.all_sent:
            # The stop has begun: it is on the path, but the motion's time has gone on without it.
            self.late = True
            return None
        chunk = self._motion.chunk(self._cycle)
        self._cycle += 1
        return chunk

    def after_sending(self, state: ArmState) -> None:
        """Nothing waits."""
