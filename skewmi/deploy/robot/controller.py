"""The robot server without its wires: what happens in each cycle and with each chunk.

Knows neither Zenoh nor wall clocks, so that every refusal and transition can be tested with
plain values; `server` connects it. Everything is called from one thread, the server's loop.
"""

from __future__ import annotations

from collections.abc import Callable

from skewmi.deploy.robot.backend import BackendFaultError, RobotBackend, RobotState
from skewmi.deploy.robot.follower import TRACKING_LIMIT, PlanFollower
from skewmi.deploy.robot.refusals import Refusal, Refusals
from skewmi.deploy.robot.states import (
    ACCEPTS_COMMANDS,
    SERVER_TABLE,
    ServerEvent,
    ServerState,
)
from skewmi.deploy.safety.lease import CommanderLease
from skewmi.deploy.safety.validation import BrokenStreamError, ChunkValidator, check_size
from skewmi.deploy.state_machine import StateMachine, Transition
from skewmi.deploy.wire.messages import decode_chunk, peek_stamp_ns
from skewmi.errors import CommandRefusedError, TransportError
from skewmi.policy_io import Array
from skewmi.trajectory import TrajectoryChunk

SILENCE_NS = 100_000_000
"""A robot that has had no cycle for so long is taken to have gone, if it says so itself."""

LEASE_NS = 2_000_000_000
"""A commander that is silent for longer than this loses the arm."""


class RobotController:
    """State machine, plan and lease of one arm.

    Args:
        backend: The robot.
        validator: Judges chunks.
        on_transition: Called after every change of state.
        lease_ns: Silence after which the commander loses the arm.
        tracking_limit: Joint error that counts as a fault, rad.
        start_ns: What the clock starts from, see `backend.fresh_start_ns`.
    """

    def __init__(
        self,
        backend: RobotBackend,
        validator: ChunkValidator,
        on_transition: Callable[[Transition[ServerState]], None] | None = None,
        *,
        lease_ns: int = LEASE_NS,
        tracking_limit: float = TRACKING_LIMIT,
        start_ns: int = 0,
    ) -> None:
        self._backend = backend
        self._validator = validator
        self.machine = StateMachine(SERVER_TABLE, on_transition)
        self.lease = CommanderLease(lease_ns)
        self.arm_motion = PlanFollower(backend, start_ns, tracking_limit)
        self.refusals = Refusals()
        self.newest_ns = -1
        """Stamp of the newest accepted chunk."""
        self.accepted = 0
        self._cycle_ns = 0

    @property
    def state(self) -> ServerState:
        return self.machine.state

    @property
    def clock_ns(self) -> int:
        """When the next sample is due."""
        return self.arm_motion.clock_ns

    @property
    def at_rest(self) -> bool:
        """Whether the plan has been followed to its end."""
        return self.arm_motion.at_rest

    @property
    def workspaces(self) -> tuple[str, ...]:
        """Names of those that can be granted at arming."""
        return self._validator.workspaces

    def may_advance(self) -> bool:
        """Whether a robot in lock-step has anything to do in its next cycles."""
        if self.state in ACCEPTS_COMMANDS:
            return self.newest_ns >= self.clock_ns
        return not self.at_rest

    def cycle(self, state: RobotState, now_ns: int) -> None:
        """Answer one cycle of the robot.

        Args:
            state: What it measured.
            now_ns: Any monotonic clock, for the lease.
        """
        self.check_lease(now_ns)
        self._cycle_ns = now_ns
        try:
            self.arm_motion.cycle(state)
        except BackendFaultError as fault:
            self.fault(str(fault))
        self._check_readiness()
        if self.at_rest:
            self.fire(ServerEvent.AT_REST, "the plan has ended")

    def no_cycle(self, now_ns: int) -> None:
        """The robot has had none lately: it may have gone.

        Args:
            now_ns: As in `cycle`.
        """
        self.check_lease(now_ns)
        missing = self._check_readiness()
        silent = now_ns - self._cycle_ns >= SILENCE_NS
        if missing and silent and self.arm_motion.state is not None:
            # Its time stands still, and what was planned will not happen any more.
            self.reseed(self.arm_motion.measured)

    def _check_readiness(self) -> bool:
        """Whether something is missing that the robot follows; then nobody commands it any more."""
        missing = self._backend.readiness()
        if missing is None:
            return False
        if self.state is ServerState.HOLDING:
            self.end(ServerEvent.WITHDRAWN, missing)
        elif self.state in (ServerState.EXECUTING, ServerState.STOPPING):
            self.fault(missing)
        return True

    def fault(self, reason: str) -> None:
        """The robot cannot go on, for a reason that it tells: as at a stop, what has begun is
        followed to its end, and what has not is dropped."""
        self._drop_what_has_not_begun()
        self.fire(ServerEvent.FAULT, reason)

    def reseed(self, q: Array) -> None:
        """Forget the plan and stay at `q`, shape (n_joints,), rad: the arm has been moved."""
        self.arm_motion.rest_at(q)

    def receive(self, payload: bytes, gid: bytes, sequence: int, now_ns: int) -> bool:
        """Judge a command as it came from the wire, and follow it if it passes.

        Args:
            payload: A JointTrajectory in CDR.
            gid: Who published it.
            sequence: Its number, counted by the publisher.
            now_ns: As in `cycle`.

        Returns:
            Whether it was accepted; if not, `refusals` says why.
        """
        self.check_lease(now_ns)
        try:
            # Decoding comes last, and only for who may command at all: it may take long.
            self.check_accepting()
            self.lease.check(gid, sequence)
            check_size(len(payload))
            self._accept(decode_chunk(payload), gid, sequence, now_ns)
        except (CommandRefusedError, TransportError) as error:
            out_of_step = isinstance(error, BrokenStreamError)
            ours = gid == self.lease.holder
            stamp_ns = peek_stamp_ns(payload)
            self.refusals.note(Refusal(str(error), out_of_step, stamp_ns, ours))
            return False
        self.accepted += 1
        return True

    def _accept(self, chunk: TrajectoryChunk, gid: bytes, sequence: int, now_ns: int) -> None:
        plan, clock_ns = self.arm_motion.plan, self.clock_ns
        self._validator.check(chunk, plan, clock_ns, self.lease.workspace)
        if chunk.stamp_ns <= self.newest_ns:
            raise CommandRefusedError(
                f"stamp {chunk.stamp_ns} ns is not after the last accepted one, {self.newest_ns} ns"
            )
        plan.splice(chunk.stamp_ns, chunk.trajectory, clock_ns)
        self.newest_ns = chunk.stamp_ns
        self.lease.renew(gid, sequence, now_ns)
        self.fire(ServerEvent.CHUNK, f"chunk of {gid.hex()[:8]}")

    def check_accepting(self) -> None:
        """Whether commands are looked at.

        Raises:
            CommandRefusedError: In which state they are not.
        """
        if self.state not in ACCEPTS_COMMANDS:
            raise CommandRefusedError(
                f"the robot server is {self.state.value} ({self.machine.reason}); arm it first"
            )

    def check_lease(self, now_ns: int) -> None:
        """Take the arm from a commander that has been silent for too long."""
        if self.lease.expired(now_ns):
            seconds = self.lease.timeout_ns / 1e9
            self.end(ServerEvent.COMMANDER_LOST, f"no command for {seconds:g} s")

    def not_ready(self) -> str | None:
        """Why the arm cannot be commanded yet, in words; None if it can."""
        missing = self._backend.readiness()
        if missing is None and self.arm_motion.state is None:
            return "it has not told where it is yet"
        return missing

    def end(self, event: ServerEvent, reason: str) -> None:
        """Something ends the present motion: it brakes, and at rest nobody commands any more."""
        self._drop_what_has_not_begun()
        self.fire(event, reason)
        if self.state is ServerState.STOPPING and self.at_rest:
            self.fire(ServerEvent.AT_REST, "the plan has ended")

    def _drop_what_has_not_begun(self) -> None:
        self.arm_motion.drop_what_has_not_begun()
        # A chunk that has been dropped is not one that others must be newer than.
        self.newest_ns = min(self.newest_ns, self.arm_motion.executed_ns)

    def fire(self, event: ServerEvent, reason: str) -> None:
        """Let an event act. Nobody commands an arm that is disarmed."""
        moved = self.machine.fire(event, reason, self.clock_ns)
        if self.state is ServerState.DISARMED:
            self.lease.close()
            if moved:
                self._backend.deactivate()
