"""The session's view of the robot server: services, status, and what its refusals mean."""

from __future__ import annotations

import time
from contextlib import suppress

import numpy as np

from skewmi.deploy.robot.description import SCENE_REQUEST, RobotDescription
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.robot.status import RobotStatus
from skewmi.deploy.safety.flange_space import TASK
from skewmi.deploy.session.arm_delay import ArmDelay
from skewmi.deploy.session.interrupt import StopRequestedError
from skewmi.deploy.session.refused import (
    LateChunkError,
    RefusedCommands,
    check_reference,
)
from skewmi.deploy.session.trust import Trust
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.arm_request import ArmRequest
from skewmi.deploy.wire.messages import (
    JointStates,
    TriggerReply,
    encode_joint_states,
)
from skewmi.deploy.wire.transport import LatestReader, Link, Publisher
from skewmi.errors import CommandRefusedError, TransportError
from skewmi.policy_io import Array
from skewmi.robot_models import yumi

CALL_TIMEOUT_S = 5.0
REST_TIMEOUT_S = 10.0

_ENDING = (ServerState.STOPPING, ServerState.DISARMED)


class RobotClient:
    """Commands a robot server, and watches what it says; `open` makes one.

    Args:
        link: An open link to it.
        trust: Whom to believe; its `server` is whose answers count.
        commands: Of `topics.YUMI_TRAJECTORY`.
        gripper: Of `topics.YUMI_GRIPPER`.
        status: Of `topics.YUMI_STATUS`; keeps all.
        dry_run: Only ask, never command.
    """

    def __init__(
        self,
        link: Link,
        trust: Trust,
        commands: Publisher,
        gripper: Publisher,
        status: LatestReader,
        *,
        dry_run: bool,
    ) -> None:
        self._link, self._trust = link, trust
        self._commands, self._gripper = commands, gripper
        self._status = status
        self._dry_run = dry_run
        self._refused = RefusedCommands(commands.gid)
        self._armed = self._heard = False
        self.delay = ArmDelay()
        """Of the arm behind its commands, as the robot server measures it."""

    @staticmethod
    def open(
        link: Link, trust: Trust, commands: Publisher, gripper: Publisher, *, dry_run: bool
    ) -> RobotClient:
        """Listen to the status of a robot server on an open link."""
        status = link.subscribe(topics.YUMI_STATUS, depth=None, senders=trust.senders)
        return RobotClient(link, trust, commands, gripper, status, dry_run=dry_run)

    @property
    def _gids(self) -> bytes:
        return self._commands.gid + self._gripper.gid

    def meet(self) -> None:
        """Find the robot server anew: it may be another one than in the last episode.

        Raises:
            TransportError: There is none, or more than one.
        """
        self._trust.meet()

    def describe(self, *, with_scene: bool = False) -> RobotDescription:
        """What the robot server is and does now.

        Args:
            with_scene: Whether to ask for the scene, too.

        Raises:
            TransportError: It does not answer, or not in our words.
        """
        description = self._ask(SCENE_REQUEST if with_scene else b"")
        self._trust.hear(description)
        return description

    def reset_scene(self, seed: int) -> None:
        """Put a simulated scene and its arm back to the start of an episode."""
        if not self._dry_run:
            self._call(topics.YUMI_SCENE_RESET, str(seed).encode())

    def arm(self, workspace: str = TASK) -> None:
        """Become the commander, or, armed already and at rest, change the workspace.

        Args:
            workspace: Where the hand may be, until it is disarmed or armed anew: one of those
                that the robot server's description names.

        Raises:
            CommandRefusedError: Somebody else is, the robot server is in fault, or it does not
                grant the workspace.
        """
        if not self._dry_run:
            name = "" if workspace == TASK else workspace
            request = ArmRequest(self._commands.gid, self._gripper.gid, name)
            self._call(topics.YUMI_ARM, request.encode())
            self._armed = True
        self._refused, self._heard = RefusedCommands(self._commands.gid), False
        self._news()

    def put_chunk(self, payload: bytes) -> None:
        """Send an encoded chunk."""
        if not self._dry_run:
            self._commands.put(payload)

    def open_gripper(self, opening: float, stamp_ns: int) -> None:
        """Command the travel of each finger from closed, m."""
        if not self._dry_run:
            names, nothing = yumi.finger_names("right")[:1], np.zeros(0)
            message = JointStates(stamp_ns, names, np.array([opening]), nothing, nothing)
            self._gripper.put(encode_joint_states(message))

    def check(self, *, late_is_final: bool) -> None:
        """Look at what the robot server has said since the last call.

        Args:
            late_is_final: Treat a late chunk as any other refused one.

        Raises:
            StopRequestedError: It was stopped.
            LateChunkError: It refused a chunk as late.
            CommandRefusedError: It refused a command for another reason.
            TransportError: It is in fault, or somebody sends in its name.
        """
        self._trust.look()
        for status in self._news():
            if status.state is ServerState.FAULT:
                raise TransportError(f"the robot server is in {status.message}")
            if status.state in _ENDING:
                raise StopRequestedError(f"the robot server is {status.message}")
            self._refused.check(status, late_is_final=late_is_final)

    def check_held(self, q: Array) -> None:
        """See that the robot server holds the arm where a motion was planned from.

        An arm at rest is held there for as long as nobody commands it, however long planning took.

        Args:
            q: Where it was held then, rad. Shape (7,).

        Raises:
            ReferenceMovedError: It holds it somewhere else now.
            TransportError: It does not answer.
        """
        if self._dry_run:
            return
        check_reference(np.array(self._ask().commanded_position), q)

    def confirm_senders(self) -> None:
        """Look once more whether anybody sends in the robot server's name.

        Raises:
            TransportError: Somebody does.
        """
        self._status.drain()
        self._trust.look()

    def wait_for_hold(self) -> Array:
        """Wait, armed, until the tail has been followed to its end.

        Returns:
            Where the robot server holds the arm, rad. Shape (7,).

        Raises:
            StopRequestedError: It was stopped meanwhile.
            CommandRefusedError: It refused a command for another reason than its time.
            TransportError: It does not come to rest, or is in fault.
        """
        deadline = time.monotonic() + REST_TIMEOUT_S
        while (told := self._ask()).state != ServerState.HOLDING.value:
            if told.state == ServerState.FAULT.value:
                raise TransportError(f"the robot server is in fault: {told.reason}")
            if told.state != ServerState.EXECUTING.value:
                raise StopRequestedError(f"the robot server is {told.state}: {told.reason}")
            if time.monotonic() > deadline:
                raise TransportError(f"the arm does not rest within {REST_TIMEOUT_S:g} s")
            time.sleep(0.02)
        for status in self._news():
            with suppress(LateChunkError):
                self._refused.check(status, late_is_final=False)
        return np.array(told.commanded_position)

    def disarm(self) -> RobotDescription | None:
        """Give the arm back, and wait until the tail has been followed to its end.

        Nobody else's run is ended by our failure: the server does it for its commander alone. Nor
        is a fault acknowledged.

        Returns:
            What the robot server says then; None if it was never armed.

        Raises:
            TransportError: It does not answer, or does not come to rest.
        """
        if not self._armed:
            return None
        deadline = time.monotonic() + REST_TIMEOUT_S
        # Refused if somebody else commands by now: then ours has come to rest before.
        self._link.call(topics.YUMI_DISARM, CALL_TIMEOUT_S, self._gids, only=self._trust.server)
        while (description := self._ask()).state == ServerState.STOPPING.value:
            if time.monotonic() > deadline:
                raise TransportError(f"the arm does not rest within {REST_TIMEOUT_S:g} s")
            time.sleep(0.005)
        self._armed = False
        return description

    def _news(self) -> list[RobotStatus]:
        """What the robot server has said, oldest first, since it first named us its commander.

        What it said before it was armed, such as that it is disarmed, may arrive after the
        answer to our arming.
        """
        news = []
        for sample in self._status.drain():
            status = RobotStatus.decode(sample.payload)
            if status is None or self._dry_run:
                continue
            self.delay.hear(status.told)
            self._heard = self._heard or self._is_ours(status)
            if self._heard:
                news.append(status)
        return news

    def _is_ours(self, status: RobotStatus) -> bool:
        return status.commander == self._commands.gid

    def _ask(self, extra: bytes = b"") -> RobotDescription:
        """A description, while the arm is ours: whom to believe stays."""
        return RobotDescription.from_json(self._call(topics.YUMI_DESCRIBE, extra).message)

    def _call(self, service: topics.Service, request: bytes = b"") -> TriggerReply:
        reply = self._link.call(service, CALL_TIMEOUT_S, request, only=self._trust.server)
        if not reply.success:
            raise CommandRefusedError(f"{service.name} was refused: {reply.message}")
        return reply
