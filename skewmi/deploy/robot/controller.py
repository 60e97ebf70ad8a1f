"""The robot server without its wires: what happens at each tick and at each request.

Knows neither Zenoh nor wall clocks, so that every refusal and transition can be tested with
plain values; `server` connects it. Everything is called from one thread, the server's loop.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skewmi.deploy.robot.backend import (
    BackendFaultError,
    Measurement,
    RobotBackend,
)
from skewmi.deploy.robot.executor import PlanExecutor
from skewmi.deploy.robot.refusals import NOTED_REFUSALS, Refusal, printable
from skewmi.deploy.robot.states import (
    ACCEPTS_COMMANDS,
    SERVER_TABLE,
    ServerEvent,
    ServerState,
)
from skewmi.deploy.safety.lease import CommanderLease
from skewmi.deploy.safety.validation import (
    BrokenStreamError,
    ChunkValidator,
    check_fresh,
    check_size,
)
from skewmi.deploy.state_machine import StateMachine, Transition
from skewmi.deploy.wire.messages import JointStates, decode_chunk, peek_stamp_ns
from skewmi.errors import CommandRefusedError, TransportError
from skewmi.policy_io import Array
from skewmi.trajectory import GRID_NS, TrajectoryChunk

LEASE_NS = 2_000_000_000
"""A commander that is silent for longer than this loses the arm."""

TRACKING_LIMIT = 0.35
"""Largest |measured - commanded| of a joint, rad, before the robot server calls it a fault."""


class RobotController:
    """State machine, plan, lease and backend of one arm.

    Args:
        backend: The robot.
        validator: Judges chunks.
        on_transition: Called after every change of state.
        lease_ns: Silence after which the commander loses the arm.
        tracking_limit: Joint error that counts as a fault, rad.
        first_tick: What the clock starts from, see `base.fresh_tick`.
    """

    def __init__(
        self,
        backend: RobotBackend,
        validator: ChunkValidator,
        on_transition: Callable[[Transition[ServerState]], None] | None = None,
        *,
        lease_ns: int = LEASE_NS,
        tracking_limit: float = TRACKING_LIMIT,
        first_tick: int = 0,
    ) -> None:
        self._backend = backend
        self._validator = validator
        self._tracking_limit = tracking_limit
        self.machine = StateMachine(SERVER_TABLE, on_transition)
        self.lease = CommanderLease(lease_ns)
        self.tick_index = first_tick
        """The tick that is due next."""
        self.plan = PlanExecutor(backend.arm_position(), first_tick)
        self.newest_tick = -1
        """First tick of the newest accepted chunk."""
        self.accepted = 0
        self.refused = 0
        self.refused_of_commander = 0
        """Since the present commander armed."""
        self.refusals: list[Refusal] = []
        self.stops = 0
        """How often somebody asked to stop, in whatever state: a commander that was between two
        episodes must not take the arm again as if nothing had been said."""

    @property
    def state(self) -> ServerState:
        return self.machine.state

    @property
    def clock_ns(self) -> int:
        """When the next sample is due."""
        return self.tick_index * GRID_NS

    def measure(self) -> Measurement:
        return self._backend.measure()

    def commanded_position(self) -> tuple[float, ...]:
        """Where the plan ends, rad."""
        return tuple(map(float, self.plan.point(self.plan.last_tick).q))

    def receive(self, payload: bytes, gid: bytes, sequence: int, now_ns: int) -> bool:
        """Judge a command as it came from the wire, and follow it if it passes.

        Args:
            payload: A JointTrajectory in CDR.
            gid: Who published it.
            sequence: Its number, counted by the publisher.
            now_ns: Any monotonic clock, for the lease.

        Returns:
            Whether it was accepted; if not, `take_refusals` says why.
        """
        self.check_lease(now_ns)
        try:
            # Decoding comes last, and only for who may command at all: it may take long.
            check_size(payload)
            self._check_state()
            self.lease.check(gid, sequence)
            self._accept(decode_chunk(payload), gid, sequence, now_ns)
        except (CommandRefusedError, TransportError) as error:
            out_of_step = isinstance(error, BrokenStreamError)
            ours = gid == self.lease.holder
            stamp_ns = peek_stamp_ns(payload)
            self.note_refusal(Refusal(str(error), out_of_step, stamp_ns, ours))
            return False
        self.accepted += 1
        return True

    def note_refusal(self, refusal: Refusal) -> None:
        """Count a refused command, for the status."""
        self.refused += 1
        self.refused_of_commander += refusal.of_commander
        if refusal.of_commander or len(self.refusals) < NOTED_REFUSALS:
            self.refusals.append(refusal._replace(reason=printable(refusal.reason)))

    def take_refusals(self) -> list[Refusal]:
        """What has been refused since the last call."""
        taken, self.refusals = self.refusals, []
        return taken

    def _check_state(self) -> None:
        if self.state not in ACCEPTS_COMMANDS:
            raise CommandRefusedError(
                f"the robot server is {self.state.value} ({self.machine.reason}); arm it first"
            )

    def _accept(self, chunk: TrajectoryChunk, gid: bytes, sequence: int, now_ns: int) -> None:
        tick = self._validator.check(chunk, self.plan, self.tick_index)
        if tick <= self.newest_tick:
            raise CommandRefusedError(
                f"stamp {chunk.stamp_ns} ns is not after the last accepted one, "
                f"{self.newest_tick * GRID_NS} ns"
            )
        self.plan.splice(tick, chunk.trajectory, self.tick_index)
        self.newest_tick = tick
        self.lease.renew(gid, sequence, now_ns)
        self._fire(ServerEvent.CHUNK, f"chunk of {gid.hex()[:8]}")

    def step(self, now_ns: int) -> None:
        """Command the target of the tick that is due, and let one grid interval pass."""
        self.check_lease(now_ns)
        target = self.plan.point(self.tick_index)
        try:
            self._backend.step(target)
            self._check_tracking(target.q)
        except BackendFaultError as fault:
            self._fire(ServerEvent.FAULT, str(fault))
        self.tick_index += 1
        if self.plan.at_rest(self.tick_index):
            self._fire(ServerEvent.AT_REST, "the plan has ended")
            if self.state is ServerState.DISARMED:
                self.lease.close()

    def _check_tracking(self, commanded: Array) -> None:
        measured = self._backend.arm_position()
        error = float(np.abs(measured - commanded).max())
        if error <= self._tracking_limit:
            return
        if np.isfinite(measured).all():
            # Whatever holds the arm shall not be pulled at, nor the arm snap back once it is free.
            self.plan.rest_at(measured, self.tick_index)
        raise BackendFaultError(
            f"a joint is {error:.3g} rad from its command; "
            f"at most {self._tracking_limit:g} rad are allowed"
        )

    def check_lease(self, now_ns: int) -> None:
        """Take the arm from a commander that has been silent for too long."""
        if self.lease.expired(now_ns):
            seconds = self.lease.timeout_ns / 1e9
            self._drop_what_has_not_begun()
            self._fire(ServerEvent.COMMANDER_LOST, f"no command for {seconds:g} s")
            self._settle()

    def arm(self, gids: bytes, now_ns: int) -> None:
        """Accept chunks from now on.

        Args:
            gids: Of the publishers of chunks and of gripper commands that become the commander,
                16 bytes each; empty for the first that sends.
            now_ns: As in `receive`.

        Raises:
            CommandRefusedError: Somebody else commands, or the state does not allow it.
        """
        self.check_lease(now_ns)
        if self.state in (ServerState.STOPPING, ServerState.FAULT):
            raise CommandRefusedError(
                f"the robot server is {self.state.value} ({self.machine.reason}); "
                "stop it first (skewmi stop acknowledges a fault)"
            )
        gid, gripper = gids[:16], gids[16:32]
        if self.state in ACCEPTS_COMMANDS and gid and gid == self.lease.holder:
            self.refused_of_commander = 0
            self.lease.gripper_holder = gripper or self.lease.gripper_holder
            self.lease.extend(now_ns)
            return
        self.lease.open(now_ns)
        self.refused_of_commander = 0
        self.lease.holder, self.lease.gripper_holder = gid or None, gripper or None
        # The arm may have sagged or been pushed while disarmed: hold where it is commanded.
        self._fire(ServerEvent.ARM, f"armed by {gid.hex()[:8] or 'a service call'}")

    def stop(self, who: str) -> None:
        """Brake along the accepted plan's tail, then disarm; at rest, acknowledge a fault.

        Args:
            who: Told in the reason; what cannot be printed, and more than a line of it, is not.

        Raises:
            CommandRefusedError: In fault, and the arm has not come to rest yet.
        """
        self.stops += 1
        if self.state is ServerState.FAULT:
            if not self.plan.at_rest(self.tick_index):
                raise CommandRefusedError(
                    f"in fault ({self.machine.reason}), and the arm has yet to come to rest: stop "
                    "again to acknowledge it"
                )
            # The arm may be far from its command: hold it where it is, do not jerk it back.
            self.plan.rest_at(self._backend.arm_position(), self.tick_index)
        self._drop_what_has_not_begun()
        self._fire(ServerEvent.STOP, f"stop asked for by {printable(who)}")
        self._settle()

    def _settle(self) -> None:
        if self.state is ServerState.STOPPING and self.plan.at_rest(self.tick_index):
            self._fire(ServerEvent.AT_REST, "the plan has ended")
        if self.state is ServerState.DISARMED:
            self.lease.close()

    def _drop_what_has_not_begun(self) -> None:
        """A chunk may be due in a while: an arm that rests until then stays where it is."""
        now, before = self.plan.point(self.tick_index), self.plan.point(self.tick_index - 1)
        if not (now.v.any() or now.a.any() or (now.q != before.q).any()):
            self.plan.rest_at(now.q, self.tick_index)

    def disarm(self, gids: bytes) -> None:
        """The commander gives the arm back: brake along the accepted plan's tail, then disarm.

        At rest or stopping already, and in fault, nothing changes.

        Args:
            gids: As in `arm`.

        Raises:
            CommandRefusedError: Somebody else commands.
        """
        if self.state not in ACCEPTS_COMMANDS:
            return
        gid, holder = gids[:16], self.lease.holder
        if holder is None or gid != holder:
            raise CommandRefusedError(
                f"{gid.hex()[:8] or 'the caller'} is not the commander "
                f"({'none yet' if holder is None else holder.hex()[:8]}); anybody may stop the "
                "arm (skewmi stop)"
            )
        self._drop_what_has_not_begun()
        self._fire(ServerEvent.DISARM, f"disarmed by its commander {gid.hex()[:8]}")
        self._settle()

    def reset_scene(self, seed: int) -> None:
        """Put scene and arm back to the start of an episode.

        Raises:
            CommandRefusedError: The arm is moving, somebody commands it, or the scene is real.
        """
        if not self.plan.at_rest(self.tick_index):
            raise CommandRefusedError("the arm is moving; stop it before resetting the scene")
        if self.lease.holder is not None and self.lease.sequence > 0:
            raise CommandRefusedError(
                f"commander {self.lease.holder.hex()[:8]} works in the scene; reset it before its "
                "first trajectory, or once it has disarmed"
            )
        q = self._backend.reset_scene(seed)
        self.plan.rest_at(q, self.tick_index)

    def follow_gripper(self, command: JointStates, gid: bytes, sequence: int | None = None) -> None:
        """`open_gripper` for a command as it was received.

        Raises:
            CommandRefusedError: Not this gripper's joint, or not made just now; or as there.
        """
        finger = self._backend.measure().names[len(self._backend.joint_names)]
        if command.names != (finger,):
            got = ", ".join(command.names[:5]) or "none"
            raise CommandRefusedError(f"one opening, that of {finger}, is expected; got {got}")
        check_fresh(command.stamp_ns, self.clock_ns)
        self.open_gripper(float(command.position[0]), gid, sequence)

    def open_gripper(self, opening: float, gid: bytes, sequence: int | None = None) -> None:
        """Move the fingers, for the commander only.

        Args:
            opening: Travel of each finger from closed, m.
            gid: Who published it.
            sequence: Its number, counted by the publisher; None is not looked at.

        Raises:
            CommandRefusedError: Not armed, another commander, or not an opening.
        """
        self._check_state()
        self.lease.check_gripper(gid, sequence)
        self._backend.open_gripper(opening)
        self.lease.renew_gripper(gid, sequence)

    def _fire(self, event: ServerEvent, reason: str) -> None:
        self.machine.fire(event, reason, self.clock_ns)
