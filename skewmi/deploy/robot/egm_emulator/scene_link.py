"""The scene's side of the link: states in the robot server's time, resets on its request.

The controller is there without it, and with a robot server that comes later or goes away: a thread
of its own opens the link, as often as it takes. Everything else is called by the controller's loop
and never waits.

Time is what the robot server says, and nobody else: that thread asks it who publishes its joint
states, and only those are looked at. One that was started again is asked again. Nor does anybody
else put the scene back: who may ask for that, and when, the robot server knows.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from skewmi.deploy.robot.backend import SceneState
from skewmi.deploy.robot.backends.egm.scene import (
    EMULATOR_RESET,
    EMULATOR_STATUS,
    SCENE_PUBLISHER,
    ResetRequest,
)
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.channels import LatestReader, Publisher, Request, Service
from skewmi.deploy.wire.messages import (
    OK,
    JointStates,
    Status,
    TriggerReply,
    decode_joint_states,
    encode_joint_states,
    encode_status,
)
from skewmi.deploy.wire.senders import Senders, TopicSenders, gids_of
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import CommandRefusedError, SkewmiError, TransportError
from skewmi.trajectory import Array

_log = logging.getLogger(__name__)

NODE_NAME = "skewmi_egm_emulator"
STATUS_PERIOD_S = 0.1
_RETRY_S = 0.5
_ANSWER_S = 5.0
_LOST_S = 5.0
"""A robot server that has said nothing for so long may be another one when it comes back."""
_REPLACED_S = 0.5
"""The same if somebody else has told joint states meanwhile."""
_QUIET_S = 0.3
"""Nothing is told of the scene's publisher to a robot server that has said nothing for so long: one
that was started again would have its sessions believe a publisher that is about to be replaced."""
_CROWD = 1_000
"""Unread joint states that are kept of everybody; see the session's observer."""
_MOST = 64
"""Of them that one cycle looks at: 16,000 a second."""


@dataclass
class Opened:
    """A link with all that the scene declares on it."""

    link: Link
    joints: LatestReader
    senders: TopicSenders
    """Whose joint states count."""
    robot_server: str
    """Zenoh id of the session that may ask for resets."""
    scene: Publisher
    status: Publisher
    reset: Service
    heard_s: float
    """When the robot server was heard of last."""

    @staticmethod
    def on(link: Link, reset: Callable[[Request], TriggerReply]) -> Opened:
        """Find the robot server, and declare what it needs.

        Raises:
            TransportError: There is none, there are several, or it does not say who publishes.
        """
        senders = Senders(link.graph.node_of)
        joints = link.subscribe(topics.YUMI_JOINT_STATES, _CROWD, senders)
        publishers, robot_server = _robot_server(link)
        senders.believe({topics.YUMI_JOINT_STATES.name: publishers})
        return Opened(
            link,
            joints,
            senders.on(topics.YUMI_JOINT_STATES),
            robot_server,
            link.publisher(topics.YUMI_SCENE_STATES),
            link.publisher(EMULATOR_STATUS),
            link.service(EMULATOR_RESET, reset, polled=True),
            time.monotonic(),
        )


class SceneLink:
    """Publishes a scene to whichever robot server is there; `open` makes one and starts its thread.

    Args:
        config: Where it is.
        state: The scene's joints now.
        contact: Largest contact since the last reset.
        reset: Puts scene and arm back for a seed; returns where the arm is then.
    """

    def __init__(
        self,
        config: TransportConfig,
        state: Callable[[], SceneState],
        contact: Callable[[], Mapping[str, float]],
        reset: Callable[[int], Array],
    ) -> None:
        self._config = config
        self._state, self._contact, self._reset = state, contact, reset
        self._opened: Opened | None = None
        self._ended = threading.Event()
        self._lost = threading.Event()
        self._lost.set()
        self._stamp_ns = -1
        self._next_status_s = 0.0
        self._thread = threading.Thread(target=self._keep_open, name="skewmi-scene", daemon=True)

    @staticmethod
    def open(
        config: TransportConfig,
        state: Callable[[], SceneState],
        contact: Callable[[], Mapping[str, float]],
        reset: Callable[[int], Array],
    ) -> SceneLink:
        """Begin to look for a robot server; see the class."""
        link = SceneLink(config, state, contact, reset)
        link._thread.start()
        return link

    @property
    def connected(self) -> bool:
        return self._opened is not None

    def serve(self) -> None:
        """Publish what is due, and answer a reset; called in every cycle."""
        opened = self._opened
        if opened is None:
            return
        try:
            opened.reset.poll()
            now_s = time.monotonic()
            self._publish_states(opened, now_s)
            if now_s >= self._next_status_s and now_s - opened.heard_s < _QUIET_S:
                self._next_status_s = now_s + STATUS_PERIOD_S
                opened.status.put(self._status(opened.scene.gid))
        except TransportError as error:
            self._give_up(f"the link broke: {error}")
            return
        patience_s = _REPLACED_S if opened.senders.strangers() else _LOST_S
        if now_s - opened.heard_s > patience_s:
            self._give_up(f"nothing from the robot server for {patience_s:g} s")

    def close(self) -> None:
        """End the thread and the link."""
        self._ended.set()
        self._lost.set()
        self._thread.join()
        if self._opened is not None:
            self._opened.link.close()

    def _publish_states(self, opened: Opened, now_s: float) -> None:
        """Scene states with the stamp of the newest joint states: the robot server's clock."""
        samples = opened.joints.drain(_MOST)
        if not samples:
            return
        opened.heard_s = now_s
        stamp_ns = decode_joint_states(samples[-1].payload).stamp_ns
        if stamp_ns == self._stamp_ns:
            return
        self._stamp_ns = stamp_ns
        scene = self._state()
        told = JointStates(
            stamp_ns, scene.names, scene.position, scene.velocity, scene.position[:0]
        )
        opened.scene.put(encode_joint_states(told))

    def _status(self, publisher: bytes) -> bytes:
        values = {key: repr(value) for key, value in self._contact().items()}
        values[SCENE_PUBLISHER] = publisher.hex()
        stamp_ns = max(self._stamp_ns, 0)
        return encode_status(Status(stamp_ns, NODE_NAME, OK, "emulated controller", values))

    def _answer_reset(self, request: Request) -> TriggerReply:
        """Put the scene back, for the robot server alone.

        The request names its session. That is no secret, so that whoever is known to be in another
        one is refused all the same; a request may be quicker, though, than the word of where its
        client is, and then its own word has to do.

        Raises:
            CommandRefusedError: It is somebody else's, or no request.
        """
        assert self._opened is not None  # it is polled
        try:
            asked = ResetRequest.from_json(request.extra)
        except ValueError as error:
            raise CommandRefusedError(f"this is no request for a reset: {error}") from error
        session = self._opened.link.graph.session_of(request.gid) or asked.robot_server
        if {session, asked.robot_server} != {self._opened.robot_server}:
            raise CommandRefusedError(
                f"client {request.gid.hex()[:8]} is not the robot server, which alone puts this "
                f"scene back: ask that ({topics.YUMI_SCENE_RESET.name})"
            )
        seed = asked.seed
        return TriggerReply(True, json.dumps([float(value) for value in self._reset(seed)]))

    def _give_up(self, reason: str) -> None:
        _log.info("scene: %s", reason)
        opened, self._opened = self._opened, None
        if opened is not None:
            # Closing may take a while: not in the controller's loop.
            threading.Thread(target=opened.link.close, daemon=True).start()
        self._lost.set()

    def _keep_open(self) -> None:
        said = False
        while True:
            self._lost.wait()
            if self._ended.is_set():
                return
            try:
                opened = self._open()
            except SkewmiError as error:
                if not said:
                    _log.info("scene: %s; trying again", error)
                    said = True
                self._ended.wait(_RETRY_S)
                continue
            said = False
            _log.info("scene: connected to %s", self._config.where)
            self._lost.clear()
            self._opened = opened

    def _open(self) -> Opened:
        link = Link.open(self._config, NODE_NAME)
        try:
            return Opened.on(link, self._answer_reset)
        except BaseException:
            link.close()
            raise


def _robot_server(link: Link) -> tuple[tuple[bytes, ...], str]:
    """Whom to take the time from, as the one robot server on the link says; and its session.

    Raises:
        TransportError: See `Opened.on`.
    """
    answers = link.call_all(topics.YUMI_DESCRIBE, _ANSWER_S)
    if len(answers) > 1:
        raise TransportError(
            f"{len(answers)} robot servers answer on this link: whose time counts cannot be told; "
            "end all but one"
        )
    told = gids_of(RobotDescription.from_json(answers[0].message).publishers)
    if not told.get(topics.YUMI_JOINT_STATES.name):
        raise TransportError("the robot server does not say who publishes its joint states")
    publishers = told[topics.YUMI_JOINT_STATES.name]
    session = answers[0].replier or link.graph.session_of(publishers[0])
    if not session:
        raise TransportError("the robot server's session is not announced yet")
    return publishers, session
