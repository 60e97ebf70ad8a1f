"""The robot server on its wires: one loop around the robot's cycle, topics and services.

Read, decide, write; then publish, and serve for a bounded time: what the robot waits for never
waits for anybody on the link.
"""

from __future__ import annotations

import gc
import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from math import isfinite

from skewmi.deploy.realtime import hot_loop
from skewmi.deploy.robot.backend import (
    BackendFaultError,
    GuidedByEgm,
    RobotBackend,
    RobotState,
)
from skewmi.deploy.robot.controller import RobotController
from skewmi.deploy.robot.description import (
    FLANGE_SPEED,
    JOINT_SPEED,
    SCENE_REQUEST,
    RobotDescription,
    limit_values,
)
from skewmi.deploy.robot.intake import (
    MAX_REQUEST_BYTES,
    QUEUE,
    CommandIntake,
    ServiceRounds,
)
from skewmi.deploy.robot.publisher import StatePublisher
from skewmi.deploy.robot.refusals import printable
from skewmi.deploy.robot.requests import RobotRequests
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.robot.workspaces import told_box, workspaces_told
from skewmi.deploy.safety.flange_space import FlangeSpace
from skewmi.deploy.safety.limits import TCP_SPEED_LIMIT
from skewmi.deploy.state_machine import Transition
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.channels import Handler, Request, Service
from skewmi.deploy.wire.messages import TriggerReply
from skewmi.deploy.wire.stop_path import StopAnswer, StopListener
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import CommandRefusedError
from skewmi.robot_models import yumi
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import CYCLE_NS, GRID_NS

_log = logging.getLogger(__name__)

_SEED_DIGITS = 18

_COLLECT_NS = 1_000_000_000
"""Garbage is collected no more often: arming and stopping without end must not cause it."""


class RobotServer:
    """Publishes states, feeds commands to the controller and answers services.

    Args:
        backend: The robot; opened and closed by `run`.
        controller: Of that robot; its `on_transition` is set to this server's.
        link: An open one, listening.
        limits: That are enforced, for the description.
        spaces: Workspaces besides the task's, likewise.
        calibration: Fingerprint of that in use, for the description; empty for none.
    """

    def __init__(
        self,
        backend: RobotBackend,
        controller: RobotController,
        link: Link,
        limits: JointLimits,
        spaces: Mapping[str, FlangeSpace] | None = None,
        *,
        calibration: str = "",
    ) -> None:
        self._calibration = calibration
        self._backend = backend
        self._controller = controller
        self._limits = limits
        self._spaces = spaces or {}
        self._requests = RobotRequests(backend, controller)
        self._publisher = StatePublisher(backend, controller, link)
        controller.machine.on_transition = self._on_transition
        chunks = link.subscribe(topics.YUMI_TRAJECTORY, depth=QUEUE)
        gripper = link.subscribe(topics.YUMI_GRIPPER, depth=QUEUE)
        self._intake = CommandIntake(controller, self._requests, chunks, gripper)
        self._publisher.dropped = lambda: self._intake.dropped
        self._collected_ns = 0
        self._stop_path: StopListener | None = None
        handlers = {
            topics.YUMI_ARM: self._arm,
            topics.YUMI_DISARM: self._disarm,
            topics.YUMI_DESCRIBE: self._describe,
        }
        if backend.scene is not None:
            handlers[topics.YUMI_SCENE_RESET] = self._reset_scene

        def serve(name: topics.Service, handler: Handler) -> Service:
            service = link.service(name, handler, polled=True)
            service.longest = MAX_REQUEST_BYTES
            return service

        self._services = ServiceRounds(
            [serve(topics.YUMI_STOP, self._stop)], [serve(*item) for item in handlers.items()]
        )

    def open_stop_path(self, config: TransportConfig) -> None:
        """Let the arm be stopped by datagrams, too, where the locators of the link allow it.

        Args:
            config: Of the link.
        """
        self._stop_path = StopListener.open(config, self._requests.brake, self._stop_answer)

    def run(
        self, stop: threading.Event, on_ready: Callable[[RobotDescription], None] | None = None
    ) -> None:
        """Serve until `stop` is set, then brake and return.

        Args:
            stop: Set by a signal handler or another thread.
            on_ready: Called once the robot is open and has been looked at.

        Raises:
            TransportError: The robot cannot be reached.
        """
        real_time = not self._backend.lock_step
        try:
            self._backend.open(self._controller.may_advance)
            self._cycle()
            if on_ready is not None:
                on_ready(self.describe())
            with hot_loop(priority=True) if real_time else _no_preparation() as granted:
                if granted:
                    _log.info("real-time loop: %s", ", ".join(granted))
                while not self._ended(stop):
                    self._cycle()
                self._read()  # a robot may carry out what it was sent last in its next cycle
        finally:
            self._backend.close()
            if self._stop_path is not None:
                self._stop_path.close()

    def _cycle(self) -> None:
        state = self._read()
        now_ns = time.monotonic_ns()
        if state is None:
            self._controller.no_cycle(now_ns)
        else:
            self._controller.cycle(state, now_ns)
            self._requests.move_fingers()
            self._publisher.states(state)
            self._publisher.executed(state)
        self._serve()
        self._publisher.carry()
        self._publisher.status()

    def _read(self) -> RobotState | None:
        try:
            return self._backend.read()
        except BackendFaultError as fault:
            self._controller.fault(str(fault))
            return None

    def _ended(self, stop: threading.Event) -> bool:
        """Whether to leave the loop: stopping was asked for, and the arm has come to rest."""
        if stop.is_set():
            # In fault it is refused until the arm rests; this loop goes on until then.
            with suppress(CommandRefusedError):
                self._requests.stop("the end of the robot server")
        return stop.is_set() and self._controller.at_rest

    def _serve(self) -> None:
        """Take what came. Commands first: a stop should not overtake them."""
        due = self._backend.due
        self._intake.serve(due)
        if self._stop_path is not None:
            self._stop_path.poll()
        self._services.serve(due)

    def _on_transition(self, transition: Transition[ServerState]) -> None:
        _log.info("%s", transition)
        self._publisher.tell(transition.stamp_ns, transition)
        if transition.target is not ServerState.DISARMED or self._backend.lock_step:
            return
        if (now_ns := time.monotonic_ns()) > self._collected_ns + _COLLECT_NS:
            # The only moment at which nobody minds: inside the loop nothing is collected.
            self._collected_ns = now_ns
            gc.collect()

    def describe(self, *, with_scene: bool = False) -> RobotDescription:
        """What this robot server is and what state it is in."""
        controller, backend, limits = self._controller, self._backend, self._limits
        scene, missing = backend.scene, controller.not_ready()
        reason = controller.machine.reason
        if missing is not None and controller.state is ServerState.DISARMED:
            reason = f"{reason}; not ready: {missing}"
        return RobotDescription(
            backend=backend.name,
            task="" if scene is None else scene.task,
            layout_hashes=() if scene is None else scene.layout_hashes,
            robot_model_hash=yumi.MODEL_HASH,
            limit_profile=limits.name,
            lock_step=backend.lock_step,
            simulated=scene is not None and scene.simulated,
            resettable=scene is not None and scene.resettable,
            cycle_ns=backend.period_ns,
            ready=missing is None,
            not_ready=missing or "",
            grid_ns=GRID_NS,
            state_period_ns=CYCLE_NS,
            state=controller.state.value,
            reason=reason,
            clock_ns=controller.clock_ns,
            joint_names=backend.joint_names,
            commanded_position=controller.arm_motion.commanded_position(),
            stops=self._requests.stops,
            limits=limit_values(limits) | _speeds(backend),
            stop_paths=() if self._stop_path is None else self._stop_path.where,
            contact={} if scene is None else scene.contact(),
            scene=scene.shapes_json if with_scene and scene is not None else "",
            publishers=self._publisher.publishers(),
            workspaces=workspaces_told(scene, self._spaces),
            workspace=controller.lease.workspace,
            calibration=self._calibration,
            box_pose={} if (box := told_box(scene)) is None else box.as_mapping(),
            egm=backend.egm() if isinstance(backend, GuidedByEgm) else {},
        )

    def _describe(self, request: Request) -> TriggerReply:
        description = self.describe(with_scene=request.extra == SCENE_REQUEST)
        return TriggerReply(True, description.to_json())

    def _arm(self, request: Request) -> TriggerReply:
        self._requests.arm(request.extra, time.monotonic_ns())
        return TriggerReply(True, f"armed ({self._controller.state.value})")

    def _disarm(self, request: Request) -> TriggerReply:
        self._requests.disarm(request.extra)
        return TriggerReply(True, self._controller.state.value)

    def _stop(self, request: Request) -> TriggerReply:
        who = request.extra.decode(errors="replace") or f"client {request.gid.hex()[:8]}"
        self._requests.stop(who)
        return TriggerReply(True, self._controller.state.value)

    def _stop_answer(self) -> StopAnswer:
        machine = self._controller.machine
        return StopAnswer(machine.state.value, machine.reason)

    def _reset_scene(self, request: Request) -> TriggerReply:
        text = request.extra.decode("ascii", errors="replace") or "0"
        if not (text.isdecimal() and len(text) <= _SEED_DIGITS):
            raise CommandRefusedError(
                f"the seed of a scene reset is a whole number of at most {_SEED_DIGITS} digits, "
                f"not negative; got {printable(text)!r}"
            )
        seed = int(text)
        self._requests.reset_scene(seed)
        return TriggerReply(True, "scene reset")


@contextmanager
def _no_preparation() -> Iterator[list[str]]:
    yield []


def _speeds(backend: RobotBackend) -> dict[str, tuple[float, ...]]:
    """What the robot admits, if that is less than what everybody keeps to."""
    told: dict[str, tuple[float, ...]] = {}
    if backend.admitted_speed < TCP_SPEED_LIMIT:
        told[FLANGE_SPEED] = (backend.admitted_speed,)
    if isfinite(backend.joint_speed):
        told[JOINT_SPEED] = (backend.joint_speed,)
    return told
