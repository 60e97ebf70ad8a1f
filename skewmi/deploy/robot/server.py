"""The robot server on its wires: one loop around the robot's cycle, topics and services.

Read, decide, write; then publish, and serve for a bounded time: what the robot waits for never
waits for anybody on the link.
"""

from __future__ import annotations

import gc
import json
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from skewmi.deploy.realtime import hot_loop
from skewmi.deploy.robot.backend import BackendFaultError, RobotBackend, RobotState
from skewmi.deploy.robot.controller import RobotController
from skewmi.deploy.robot.description import (
    FLANGE_SPEED,
    SCENE_REQUEST,
    RobotDescription,
    limit_values,
)
from skewmi.deploy.robot.publisher import StatePublisher
from skewmi.deploy.robot.refusals import Refusal
from skewmi.deploy.robot.requests import RobotRequests
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.safety.limits import TCP_SPEED_LIMIT
from skewmi.deploy.safety.validation import check_size
from skewmi.deploy.state_machine import Transition
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.channels import Request, Sample
from skewmi.deploy.wire.messages import TriggerReply, decode_joint_states
from skewmi.deploy.wire.transport import Link
from skewmi.errors import CommandRefusedError, TransportError
from skewmi.robot_models import yumi
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import CYCLE_NS, GRID_NS

_log = logging.getLogger(__name__)

COMMANDS_NS = 1_500_000
"""Time that commands may take between two cycles; the rest waits for the next, oldest first."""


class RobotServer:
    """Publishes states, feeds commands to the controller and answers services.

    Args:
        backend: The robot; opened and closed by `run`.
        controller: Of that robot; its `on_transition` is set to this server's.
        link: An open one, listening.
        limits: That are enforced, for the description.
    """

    def __init__(
        self,
        backend: RobotBackend,
        controller: RobotController,
        link: Link,
        limits: JointLimits,
    ) -> None:
        self._backend = backend
        self._controller = controller
        self._limits = limits
        self._requests = RobotRequests(backend, controller)
        self._publisher = StatePublisher(backend, controller, link)
        controller.machine.on_transition = self._on_transition
        self._commands = link.subscribe(topics.YUMI_TRAJECTORY, depth=None)
        self._gripper = link.subscribe(topics.YUMI_GRIPPER, depth=None)
        self._unread: deque[Sample] = deque()
        self._services = [
            link.service(topics.YUMI_DESCRIBE, self._describe, polled=True),
            link.service(topics.YUMI_ARM, self._arm, polled=True),
            link.service(topics.YUMI_DISARM, self._disarm, polled=True),
            link.service(topics.YUMI_STOP, self._stop, polled=True),
        ]
        if backend.scene is not None:
            self._services.append(
                link.service(topics.YUMI_SCENE_RESET, self._reset_scene, polled=True)
            )

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
        self._backend.open(self._controller.may_advance)
        try:
            self._cycle()
            if on_ready is not None:
                on_ready(self.describe())
            with hot_loop(priority=True) if real_time else _no_preparation() as granted:
                if granted:
                    _log.info("real-time loop: %s", ", ".join(granted))
                while not self._ended(stop):
                    self._cycle()
        finally:
            self._backend.close()

    def _cycle(self) -> None:
        state = self._read()
        now_ns = time.monotonic_ns()
        if state is None:
            self._controller.no_cycle(now_ns)
        else:
            self._controller.cycle(state, now_ns)
            self._publisher.states(state)
        self._serve()
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
        if not self._unread:
            self._unread.extend(self._commands.drain())
        until_ns = time.monotonic_ns() + COMMANDS_NS
        while self._unread and (now_ns := time.monotonic_ns()) < until_ns:
            sample = self._unread.popleft()
            self._controller.receive(sample.payload, sample.gid, sample.sequence, now_ns)
        for sample in self._gripper.drain():
            self._follow_gripper(sample)
        for service in self._services:
            service.poll()

    def _follow_gripper(self, sample: Sample) -> None:
        try:
            check_size(sample.payload)
            command = decode_joint_states(sample.payload)
            self._requests.follow_gripper(command, sample.gid, sample.sequence)
        except (CommandRefusedError, TransportError) as error:
            ours = sample.gid == self._controller.lease.gripper_holder
            self._controller.refusals.note(Refusal(f"gripper: {error}", of_commander=ours))

    def _on_transition(self, transition: Transition[ServerState]) -> None:
        _log.info("%s", transition)
        self._publisher.tell(transition.stamp_ns, transition)
        if transition.target is ServerState.DISARMED and not self._backend.lock_step:
            # The only moment at which nobody minds: inside the loop nothing is collected.
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
            limits=limit_values(limits) | _flange_speed(backend),
            contact={} if scene is None else scene.contact(),
            scene=scene.shapes_json if with_scene and scene is not None else "",
            publishers=self._publisher.publishers(),
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

    def _reset_scene(self, request: Request) -> TriggerReply:
        try:
            seed = int(json.loads(request.extra or b"0"))
        except (ValueError, TypeError) as error:
            raise CommandRefusedError(
                f"the seed of a scene reset is not a number: {error}"
            ) from error
        self._requests.reset_scene(seed)
        return TriggerReply(True, "scene reset")


@contextmanager
def _no_preparation() -> Iterator[list[str]]:
    yield []


def _flange_speed(backend: RobotBackend) -> dict[str, tuple[float, ...]]:
    """What the robot admits, if that is less than what everybody keeps to."""
    speed = backend.admitted_speed
    return {FLANGE_SPEED: (speed,)} if speed < TCP_SPEED_LIMIT else {}
