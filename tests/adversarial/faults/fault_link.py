"""A link between session and robot server that can do everything links do to messages, and worse.

Two Zenoh sessions: the session connects to one, the other connects to the server. Messages and
service calls pass through byte by byte, attachments included, unless a fault says otherwise.
"""

from __future__ import annotations

import heapq
import itertools
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import zenoh

from skewmi.deploy.robot.process import free_port
from skewmi.deploy.wire import ros2_keys, topics
from skewmi.deploy.wire.messages import (
    Status,
    decode_chunk,
    decode_status,
    encode_chunk,
)
from skewmi.deploy.wire.transport import TransportConfig
from skewmi.trajectory import TrajectoryChunk

SERVICE_TIMEOUT_S = 5.0
MOVING = 0.2
"""Joint speed from which on the arm counts as moving, rad/s."""
HEARD_OUT_S = 3.0
"""For two statuses, of which one comes every half second."""
DOMAIN = 0


@dataclass(frozen=True)
class Message:
    """A sample as it travels."""

    payload: bytes
    attachment: bytes

    @property
    def chunk(self) -> TrajectoryChunk:
        return decode_chunk(self.payload)

    @property
    def sequence(self) -> int:
        return ros2_keys.decode_attachment(self.attachment)[0]

    @property
    def source_time_ns(self) -> int:
        """The sender's wall clock."""
        return ros2_keys.decode_attachment(self.attachment)[1]

    def with_chunk(self, chunk: TrajectoryChunk) -> Message:
        return replace(self, payload=encode_chunk(chunk))

    def with_sequence(self, sequence: int) -> Message:
        _, stamp, gid = ros2_keys.decode_attachment(self.attachment)
        return replace(self, attachment=ros2_keys.encode_attachment(sequence, stamp, gid))


Delivery = tuple[float, Message]
"""(seconds from now, message)"""


class FaultLink:
    """Forwards everything; `on_chunk`, `on_state` and `when_moving` are where faults act.

    Args:
        robot: Locator of the robot server.
        lock_step: Its pace.
    """

    def __init__(self, robot: str, *, lock_step: bool) -> None:
        self.locator = f"tcp/127.0.0.1:{free_port()}"
        self._config = TransportConfig(lock_step=lock_step)
        self._robot_config = TransportConfig.for_client(robot, lock_step=lock_step)
        self.on_chunk: Callable[[Message], list[Delivery]] | None = None
        """What becomes of a chunk on its way to the robot server."""
        self.on_state: Callable[[topics.Topic, Message], Message | None] | None = None
        """What becomes of a joint or scene state, or a status, on its way to the session."""
        self.on_stopped: Callable[[], None] | None = None
        """Called once when the session's own stop has been answered by the robot server."""
        self._robot_statuses: list[Status] = []
        self._heard = threading.Condition()
        self.last_chunk: Message | None = None
        self.times: dict[str, list[tuple[int, int]]] = {}
        """Topic -> (our monotonic clock, sender's wall clock) of all messages, ns."""
        self._phase = ""
        self._lead_ns = 0
        self._moves_ns: int | None = None
        self._awaited: tuple[str, Callable[[], None]] | None = None
        self._queue: list[tuple[float, int, Message]] = []
        self._order = itertools.count()
        self._wake = threading.Condition()
        self._closing = False
        self._robot: Any = None

    def __enter__(self) -> Self:
        self._session = zenoh.open(replace(self._config, listen=(self.locator,)).zenoh())
        session_sees = (topics.YUMI_JOINT_STATES, topics.YUMI_SCENE_STATES, topics.YUMI_STATUS)
        self._to_session = {t.name: self._publisher(self._session, t) for t in session_sees}
        self.connect_robot()
        self._declared = [
            self._listen(self._session, topics.YUMI_TRAJECTORY, self._from_session),
            self._listen(self._session, topics.YUMI_GRIPPER, self._from_session),
            self._listen(self._session, topics.YUMI_STATUS, self._session_says),
        ]
        for service in topics.SERVICES:
            queryable = self._session.declare_queryable(
                ros2_keys.data_key(DOMAIN, service), zenoh.handlers.FifoChannel(64), complete=True
            )
            self._declared.append(queryable)
            threading.Thread(target=self._serve, args=(service, queryable), daemon=True).start()
        threading.Thread(target=self._deliver, daemon=True).start()
        return self

    def connect_robot(self) -> None:
        """Open the robot server's side, anew if the robot server is a new one."""
        if self._robot is not None:
            self._robot.close()
        self._robot = zenoh.open(self._robot_config.zenoh())
        commands = (topics.YUMI_TRAJECTORY, topics.YUMI_GRIPPER)
        self._to_robot = {t.name: self._publisher(self._robot, t) for t in commands}
        self._robot_declared = [
            self._listen(self._robot, topic, self._from_robot)
            for topic in (topics.YUMI_JOINT_STATES, topics.YUMI_SCENE_STATES, topics.YUMI_STATUS)
        ]

    def __exit__(self, *_: object) -> None:
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._session.close()
        self._robot.close()

    def when_moving(self, phase: str, lead_ms: float, action: Callable[[], None]) -> None:
        """Call `action` once, when the arm moves in a session's phase and the next chunk comes.

        A chunk moves the arm `lead_ms` after it was sent.
        """
        self._awaited = (phase, action)
        self._lead_ns = round(lead_ms * 1e6)
        self._moves_ns = None

    def send(self, message: Message, delay_s: float = 0.0) -> None:
        """To the robot server, now or later, whatever the faults."""
        if delay_s <= 0.0:
            self._put(self._to_robot[topics.YUMI_TRAJECTORY.name], message)
            return
        with self._wake:
            due = time.monotonic() + delay_s
            heapq.heappush(self._queue, (due, next(self._order), message))
            self._wake.notify()

    def to_session(self, topic: topics.Topic, message: Message) -> None:
        """To the session, whatever the faults."""
        self._put(self._to_session[topic.name], message)

    def said_by_robot(self) -> str:
        """Reasons and refusals that the robot server told since the first chunk, each once."""
        said = [
            text
            for status in list(self._robot_statuses)
            for text in (status.values.get("reason", ""), status.values.get("refusal", ""))
        ]
        return " | ".join(dict.fromkeys(text for text in said if text))

    def hear_robot_out(self) -> None:
        """Wait for what the robot server has yet to tell of what it was sent, if it is still there.

        Refusals of others than the commander are told a little later, and who has given the arm
        back is one of the others. Of two statuses the second was made after this call.
        """
        with self._heard:
            enough = len(self._robot_statuses) + 2
            self._heard.wait_for(lambda: len(self._robot_statuses) >= enough, HEARD_OUT_S)

    def _publisher(self, session: Any, topic: topics.Topic) -> Any:
        congestion = zenoh.CongestionControl
        return session.declare_publisher(
            ros2_keys.data_key(DOMAIN, topic),
            congestion_control=congestion.BLOCK if self._config.lock_step else congestion.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )

    def _listen(self, session: Any, topic: topics.Topic, use: Callable[..., None]) -> Any:
        def callback(sample: Any) -> None:
            if sample.attachment is None:
                return
            message = Message(sample.payload.to_bytes(), sample.attachment.to_bytes())
            clocks = (time.monotonic_ns(), message.source_time_ns)
            self.times.setdefault(topic.name, []).append(clocks)
            use(topic, message)

        remote = zenoh.Locality.REMOTE
        key = ros2_keys.data_key(DOMAIN, topic)
        return session.declare_subscriber(key, callback, allowed_origin=remote)

    def _from_session(self, topic: topics.Topic, message: Message) -> None:
        if topic is not topics.YUMI_TRAJECTORY:
            self._put(self._to_robot[topic.name], message)
            return
        if self._awaited is not None and self._awaited[0] == self._phase:
            chunk = message.chunk
            moves = np.abs(chunk.trajectory.v[0]).max() > MOVING
            if moves and self._moves_ns is None:
                self._moves_ns = chunk.stamp_ns
            if moves and chunk.stamp_ns - (self._moves_ns or 0) >= self._lead_ns:
                action, self._awaited = self._awaited[1], None
                action()
        self.last_chunk = message
        deliveries = [(0.0, message)] if self.on_chunk is None else self.on_chunk(message)
        for delay_s, out in deliveries:
            self.send(out, delay_s)

    def _from_robot(self, topic: topics.Topic, message: Message) -> None:
        out: Message | None = message
        if topic is topics.YUMI_STATUS and self.last_chunk is not None:
            with self._heard:
                self._robot_statuses.append(decode_status(message.payload))
                self._heard.notify_all()
        if self.on_state is not None:
            out = self.on_state(topic, message)
        if out is not None:
            self._put(self._to_session[topic.name], out)

    def _session_says(self, topic: topics.Topic, message: Message) -> None:
        del topic
        self._phase = decode_status(message.payload).values.get("state", "")

    def _serve(self, service: topics.Service, queryable: Any) -> None:
        try:
            for query in queryable:
                with query:
                    self._answer(service, query)
        except zenoh.ZError:
            return  # the session was closed

    def _answer(self, service: topics.Service, query: Any) -> None:
        try:
            replies = self._robot.get(
                query.key_expr,
                zenoh.handlers.FifoChannel(4),
                timeout=SERVICE_TIMEOUT_S,
                payload=query.payload,
                attachment=query.attachment,
            )
            for reply in replies:
                if reply.ok is not None:
                    if service is topics.YUMI_DISARM and self.on_stopped is not None:
                        action, self.on_stopped = self.on_stopped, None
                        action()
                    query.reply(query.key_expr, reply.ok.payload, attachment=reply.ok.attachment)
        except zenoh.ZError:
            return  # the robot server is gone: no answer is the answer

    def _put(self, publisher: Any, message: Message) -> None:
        try:
            publisher.put(message.payload, attachment=message.attachment)
        except zenoh.ZError:
            return  # closing, or the robot server is gone

    def _deliver(self) -> None:
        with self._wake:
            while not self._closing:
                now = time.monotonic()
                while self._queue and self._queue[0][0] <= now:
                    self.send(heapq.heappop(self._queue)[2])
                self._wake.wait(self._queue[0][0] - now if self._queue else None)
