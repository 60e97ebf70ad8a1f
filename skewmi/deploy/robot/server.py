"""The robot server on its wires: clock, topics and services around the controller.

Real time: the clock counts 4 ms ticks from a start that differs each time (`base.fresh_tick`),
driven by the monotonic clock.
Lock-step: the clock moves by one state period (20 ms) once a chunk that starts at or after it
has been accepted, as fast as both sides can; without a commander it stands still.
"""

from __future__ import annotations

import gc
import json
import logging
import threading
import time
from contextlib import suppress
from dataclasses import dataclass

from skewmi.deploy.realtime import hot_loop
from skewmi.deploy.robot.backend import RobotBackend
from skewmi.deploy.robot.controller import RobotController
from skewmi.deploy.robot.description import SCENE_REQUEST, RobotDescription, limit_values
from skewmi.deploy.robot.refusals import Refusal
from skewmi.deploy.robot.states import ACCEPTS_COMMANDS, ServerState
from skewmi.deploy.safety.validation import check_size
from skewmi.deploy.state_machine import Transition
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.channels import Request
from skewmi.deploy.wire.messages import (
    ERROR,
    OK,
    WARN,
    JointStates,
    Status,
    TriggerReply,
    decode_joint_states,
    encode_joint_states,
    encode_status,
)
from skewmi.deploy.wire.transport import Link
from skewmi.errors import CommandRefusedError, TransportError
from skewmi.robot_models import yumi
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import CYCLE_NS, CYCLE_TICKS, GRID_NS

_log = logging.getLogger(__name__)

STATUS_NAME = "skewmi_robot"
"""Name of the robot server's entry in the status messages."""

MAX_BACKLOG_NS = 20_000_000
"""A real-time clock that falls behind by more than this slips instead of rushing after it:
a rush would make every chunk late that was planned in the meantime."""

_STATUS_PERIOD_NS = 500_000_000
_IDLE_REPUBLISH_NS = 50_000_000
_IDLE_SLEEP_S = 30e-6
_SHOWN_REFUSALS = 3


@dataclass(frozen=True)
class ServerOptions:
    """How a robot server runs. Joint and scene states are published every `CYCLE_TICKS` ticks."""

    limits: JointLimits
    lock_step: bool = False


class RobotServer:
    """Publishes states, feeds commands to the controller and answers services.

    Args:
        backend: The robot.
        controller: Of that robot; its `on_transition` is set to this server's.
        link: An open session, listening.
        options: Limits, lock-step and rates.
    """

    def __init__(
        self,
        backend: RobotBackend,
        controller: RobotController,
        link: Link,
        options: ServerOptions,
    ) -> None:
        self._backend = backend
        self._controller = controller
        self._options = options
        controller.machine.on_transition = self._on_transition
        self._commands = link.subscribe(topics.YUMI_TRAJECTORY, depth=None)
        self._gripper = link.subscribe(topics.YUMI_GRIPPER, depth=None)
        self._joint_states = link.publisher(topics.YUMI_JOINT_STATES)
        self._scene_states = link.publisher(topics.YUMI_SCENE_STATES)
        self._status = link.publisher(topics.YUMI_STATUS)
        self._services = [
            link.service(topics.YUMI_DESCRIBE, self._describe, polled=True),
            link.service(topics.YUMI_ARM, self._arm, polled=True),
            link.service(topics.YUMI_DISARM, self._disarm, polled=True),
            link.service(topics.YUMI_STOP, self._stop, polled=True),
            link.service(topics.YUMI_SCENE_RESET, self._reset_scene, polled=True),
        ]
        self.slips = 0
        """How often the real-time clock was set back because this process came too late."""
        self._next_status_ns = 0
        self._refused_seen = 0

    def run(self, stop: threading.Event) -> None:
        """Serve until `stop` is set, then brake and return."""
        if self._options.lock_step:
            self._run_lock_step(stop)
            return
        with hot_loop(priority=True) as granted:
            _log.info("real-time loop: %s", ", ".join(granted))
            self._run_real_time(stop)

    def _ended(self, stop: threading.Event) -> bool:
        """Whether to leave the loop: stopping was asked for, and the arm has come to rest."""
        if stop.is_set():
            # In fault it is refused until the arm rests; this loop goes on until then.
            with suppress(CommandRefusedError):
                self._controller.stop("the end of the robot server")
        return stop.is_set() and self._controller.plan.at_rest(self._controller.tick_index)

    def _run_real_time(self, stop: threading.Event) -> None:
        due_ns = time.monotonic_ns()
        while not self._ended(stop):
            if self._controller.tick_index % CYCLE_TICKS == 0:
                self._publish_states()
            self._serve()
            self._controller.step(time.monotonic_ns())
            due_ns += GRID_NS
            behind_ns = time.monotonic_ns() - due_ns
            if behind_ns > MAX_BACKLOG_NS:
                self.slips += 1
                due_ns += behind_ns
            elif behind_ns < 0:
                time.sleep(-behind_ns / 1e9)

    def _run_lock_step(self, stop: threading.Event) -> None:
        self._publish_states()
        published_ns = time.monotonic_ns()
        while not self._ended(stop):
            self._serve()
            now_ns = time.monotonic_ns()
            self._controller.check_lease(now_ns)
            if self._may_advance():
                for _ in range(CYCLE_TICKS):
                    self._controller.step(now_ns)
            elif now_ns - published_ns < _IDLE_REPUBLISH_NS:
                time.sleep(_IDLE_SLEEP_S)
                continue
            # Without progress this is for those who come late; the stamp tells them.
            self._publish_states()
            published_ns = now_ns

    def _may_advance(self) -> bool:
        controller = self._controller
        if controller.state in ACCEPTS_COMMANDS:
            return controller.newest_tick >= controller.tick_index
        return not controller.plan.at_rest(controller.tick_index)

    def _serve(self) -> None:
        """Take everything that came. Commands first: a stop must not overtake them."""
        for sample in self._commands.drain():
            self._controller.receive(
                sample.payload, sample.gid, sample.sequence, time.monotonic_ns()
            )
        for sample in self._gripper.drain():
            try:
                check_size(sample.payload)
                command = decode_joint_states(sample.payload)
                self._controller.follow_gripper(command, sample.gid, sample.sequence)
            except (CommandRefusedError, TransportError) as error:
                ours = sample.gid == self._controller.lease.gripper_holder
                self._controller.note_refusal(Refusal(f"gripper: {error}", of_commander=ours))
        for service in self._services:
            service.poll()
        if self._controller.refused != self._refused_seen:
            self._refused_seen = self._controller.refused
            self._publish_status(self._controller.clock_ns)

    def _publish_states(self) -> None:
        measured = self._controller.measure()
        stamp_ns = self._controller.clock_ns
        # The scene first: whoever sees joint states of a stamp has its scene states already.
        if measured.scene_names:
            scene = JointStates(
                stamp_ns,
                measured.scene_names,
                measured.scene_position,
                measured.scene_velocity,
                measured.scene_position[:0],
            )
            self._scene_states.put(encode_joint_states(scene))
        joints = JointStates(
            stamp_ns, measured.names, measured.position, measured.velocity, measured.effort
        )
        self._joint_states.put(encode_joint_states(joints))
        now_ns = time.monotonic_ns()
        if now_ns >= self._next_status_ns:
            self._next_status_ns = now_ns + _STATUS_PERIOD_NS
            self._publish_status(stamp_ns)

    def _on_transition(self, transition: Transition[ServerState]) -> None:
        _log.info("%s", transition)
        self._publish_status(transition.stamp_ns, transition)
        if transition.target is ServerState.DISARMED and not self._options.lock_step:
            # The only moment at which nobody minds: inside the loop nothing is collected.
            gc.collect()

    def _publish_status(
        self, stamp_ns: int, transition: Transition[ServerState] | None = None
    ) -> None:
        controller = self._controller
        # The commander's own come first: they are what it has to answer for.
        refusals = sorted(controller.take_refusals(), key=lambda r: not r.of_commander)
        level = OK if controller.refused == 0 else WARN
        if controller.state is ServerState.FAULT:
            level = ERROR
        values = {
            "state": controller.state.value,
            "reason": controller.machine.reason,
            "accepted": str(controller.accepted),
            "refused": str(controller.refused),
            "refusal": "; ".join(refusal.reason for refusal in refusals[:_SHOWN_REFUSALS]),
            "refused_stamps_ns": " ".join(str(refusal.stamp_ns) for refusal in refusals),
            "out_of_step": str(all(r.out_of_step for r in refusals if r.of_commander)),
            "refused_of_commander": str(controller.refused_of_commander),
            "commander": (controller.lease.holder or b"").hex(),
            "slips": str(self.slips),
        }
        if transition is not None:
            values |= {"from": transition.source.value, "event": transition.event}
        message = f"{controller.state.value}: {controller.machine.reason}"
        self._status.put(encode_status(Status(stamp_ns, STATUS_NAME, level, message, values)))

    def _describe(self, request: Request) -> TriggerReply:
        description = self.describe(with_scene=request.extra == SCENE_REQUEST)
        return TriggerReply(True, description.to_json())

    def describe(self, *, with_scene: bool = False) -> RobotDescription:
        """What this robot server is and what state it is in."""
        controller, options, backend = self._controller, self._options, self._backend
        limits = options.limits
        return RobotDescription(
            backend=backend.name,
            task=backend.task,
            layout_hashes=backend.layout_hashes,
            robot_model_hash=yumi.MODEL_HASH,
            limit_profile=limits.name,
            lock_step=options.lock_step,
            simulated=backend.simulated,
            grid_ns=GRID_NS,
            state_period_ns=CYCLE_NS,
            state=controller.state.value,
            reason=controller.machine.reason,
            clock_ns=controller.clock_ns,
            joint_names=backend.joint_names,
            commanded_position=controller.commanded_position(),
            stops=controller.stops,
            limits=limit_values(limits),
            contact=backend.contact(),
            scene=backend.scene_json if with_scene else "",
        )

    def _arm(self, request: Request) -> TriggerReply:
        self._controller.arm(request.extra, time.monotonic_ns())
        return TriggerReply(True, f"armed ({self._controller.state.value})")

    def _disarm(self, request: Request) -> TriggerReply:
        self._controller.disarm(request.extra)
        return TriggerReply(True, self._controller.state.value)

    def _stop(self, request: Request) -> TriggerReply:
        who = request.extra.decode(errors="replace") or f"client {request.gid.hex()[:8]}"
        self._controller.stop(who)
        return TriggerReply(True, self._controller.state.value)

    def _reset_scene(self, request: Request) -> TriggerReply:
        try:
            seed = int(json.loads(request.extra or b"0"))
        except (ValueError, TypeError) as error:
            raise CommandRefusedError(
                f"the seed of a scene reset is not a number: {error}"
            ) from error
        self._controller.reset_scene(seed)
        return TriggerReply(True, "scene reset")
