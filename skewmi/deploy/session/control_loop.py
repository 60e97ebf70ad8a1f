"""The loop that moves the arm: read its state, decide on the next chunk, write it."""

from __future__ import annotations

import threading
from typing import Protocol

from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.interrupt import check_interrupt
from skewmi.deploy.session.observer import Observer
from skewmi.deploy.session.refused import LateChunkError, OutOfStepError
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.deploy.session.status import SessionStatus
from skewmi.deploy.session.stream import ChunkStream
from skewmi.deploy.session.timing import CycleTimes
from skewmi.policy_io import Array
from skewmi.trajectory import JointTrajectory


class Motion(Protocol):
    """What a loop carries out: it decides on one chunk after the other."""

    def begin(self, q: Array, state: ArmState) -> None:
        """Begin, or go on with, the motion where the arm rests.

        The first chunk answers this state: what takes long, such as planning a way, is done before
        the motion is given to the loop.

        Args:
            q: Where the robot server holds the arm, rad. Shape (7,).
            state: The newest state.
        """

    def is_over(self, state: ArmState) -> bool:
        """Whether nothing is left to do; asked when a state has come."""

    def next_chunk(self, state: ArmState, splice: int) -> JointTrajectory | None:
        """Decide what follows.

        Args:
            state: The newest state.
            splice: Sample of the previous chunk at which this one must start.

        Returns:
            What to send; None if the motion ends with what was sent before.
        """

    def after_sending(self, state: ArmState) -> None:
        """Do what may wait until the arm has its chunk."""


class ControlLoop:
    """Carries out motions, one cycle per state of the arm.

    Args:
        robot: Who may refuse a chunk, or be stopped by somebody.
        observer: Where states come from.
        stream: Where chunks go to.
        times: How long the stages of a cycle take.
        status: Keeps the time of the newest state.
        stop: Set from outside to end the run.
        lock_step: The robot server waits for us: to it, a late chunk is as bad as any refused one.
    """

    def __init__(
        self,
        robot: RobotClient,
        observer: Observer,
        stream: ChunkStream,
        times: CycleTimes,
        status: SessionStatus,
        stop: threading.Event,
        *,
        lock_step: bool,
    ) -> None:
        self._robot = robot
        self._observer = observer
        self._stream = stream
        self._times = times
        self._status = status
        self._stop = stop
        self._lock_step = lock_step

    def run(self, motion: Motion, q: Array, state: ArmState) -> ArmState:
        """Carry out a motion.

        Args:
            motion: What to do.
            q: Where the robot server holds the arm, rad. Shape (7,).
            state: The newest state that is known; how old it is does not matter.

        Returns:
            The newest state; what was sent last is still followed to its end.

        Raises:
            LateChunkError: The robot server refused a chunk for being late; see `recover`.
            ReferenceMovedError: The arm is not held at `q`, and nothing was sent; see `recover`.
            SkewmiError: Whatever else ends a motion; nothing has been sent since.
        """
        if not self._lock_step:
            # Time has gone on while the motion was planned: it must not be taken from the lead.
            self._robot.check_held(q)
            state = self._observer.state_from_now()
            self._status.clock_ns = state.stamp_ns
        motion.begin(q, state)
        self._stream.begin(q, state.stamp_ns)
        while not motion.is_over(state):
            self._times.start(state.received_ns)
            self._observer.check_scene()
            # One chunk per state as a rule; two if a state was lost.
            for splice in self._stream.due(state.stamp_ns, state.received_ns):
                chunk = motion.next_chunk(state, splice)
                if chunk is None:
                    return state
                self._times.lap("plan")
                self._stream.send(chunk)
                motion.after_sending(state)
            self._times.stop()
            state = self._read()
        return state

    def coast(self, state: ArmState) -> tuple[Array, ArmState]:
        """Send nothing more, and wait until the arm has followed what was sent to its end.

        Returns:
            Where it rests, rad, and the newest state.

        Raises:
            As `run`.
        """
        sent, rest_ns = self._stream.sent, self._stream.rest_ns
        assert sent is not None
        while state.stamp_ns < rest_ns:
            self._times.start(state.received_ns)
            self._observer.check_scene()
            self._times.stop()
            state = self._read()
        return sent.trajectory.q[-1], state

    def recover(self, error: OutOfStepError) -> tuple[Array, ArmState]:
        """Wait, armed, until the arm rests after a motion that was out of step.

        Args:
            error: That ended it; a chunk that was late counts as a missed cycle.

        Returns:
            Where the robot server holds it, rad, and the newest state.

        Raises:
            SkewmiError: It does not come to rest, or somebody has asked to stop.
        """
        q = self._robot.wait_for_hold()
        if isinstance(error, LateChunkError):
            self._stream.missed_cycles += 1
        state = self._observer.fresh_state()
        check_interrupt(self._stop)
        return q, state

    def confirm_senders(self) -> None:
        """Look through what has come since, unread, for somebody who sends in another's name.

        Raises:
            TransportError: There is somebody.
        """
        self._observer.forget()
        self._robot.confirm_senders()

    def _read(self) -> ArmState:
        """The next state of the arm, unless somebody or something ends the motion."""
        while (state := self._observer.next_state()) is None:
            # Time stands still in lock-step: what the robot server waits for, it may have told.
            self._check(late_is_final=True)
        self._status.clock_ns = state.stamp_ns
        self._check(late_is_final=self._lock_step)
        return state

    def _check(self, *, late_is_final: bool) -> None:
        check_interrupt(self._stop)
        self._robot.check(late_is_final=late_is_final)
