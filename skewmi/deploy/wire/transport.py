"""The message link between session and robot server: Zenoh sessions that ROS 2 nodes understand.

By default the robot server listens on the loopback interface and everybody else connects to it;
nothing is announced or searched on the network. The robot server's session is a Zenoh *router*,
so that it passes the session's commands on to recorders and ROS 2 nodes connected to it; no
separate router has to run.

Delivery. In real time a command that could not be sent at once is worthless, and a blocked
send would stall the loop that keeps the arm safe: commands and states are dropped under
congestion, commands go first (real-time priority) and none waits to be batched (express).
In lock-step both sides wait for each other's next message, so a dropped one would hang the
run: then sending blocks instead. Zenoh closes a session that stays blocked for five seconds,
which in lock-step can only mean that the peer is gone.

Replies block in real time, too: Zenoh lets the caller choose how they are sent. Who does not read
them is therefore put out after ten milliseconds, or it would hold up the loop that answers.

A subscription takes effect some milliseconds after `subscribe` returns, and Zenoh's matching
status tells of it before messages flow: whoever must not miss a first message waits for one,
or asks a service first.

Threads: a `Link` and its readers belong to the thread that uses them; handlers of services
declared without `polled` run in a thread each.
"""

from __future__ import annotations

import json
import time
from typing import Any, Self

import zenoh

from skewmi.deploy.wire import messages, ros2_keys, runtime, tls_diagnosis, zenoh_file
from skewmi.deploy.wire.calls import Caller
from skewmi.deploy.wire.channels import Handler, LatestReader, Publisher, Sample, Service
from skewmi.deploy.wire.liveliness import Graph
from skewmi.deploy.wire.ros2_keys import QOS_BEST_EFFORT_1, QOS_RELIABLE_10, EntityKind
from skewmi.deploy.wire.senders import Senders
from skewmi.deploy.wire.topics import YUMI_DESCRIBE, Topic
from skewmi.deploy.wire.topics import Service as ServiceName
from skewmi.deploy.wire.transport_config import TransportConfig
from skewmi.errors import TransportError

__all__ = ["LatestReader", "Link", "Publisher", "Sample", "TransportConfig"]


_ALL = 10_000
"""Unread messages that are kept where all are wanted."""


class Link:
    """One Zenoh session seen as one ROS 2 node; a context manager that closes it; `open` makes one.

    Args:
        session: An open Zenoh session.
        config: What it was opened with.
        node: How the session is known in ROS 2.
        node_token: The declared liveliness token of the node.
        graph: Who else is on the link.
    """

    def __init__(
        self,
        session: Any,
        config: TransportConfig,
        node: ros2_keys.Node,
        node_token: Any,
        graph: Graph,
    ) -> None:
        self._session = session
        self._config = config
        self._node = node
        self._entities = 0
        self._declared: list[Any] = []
        self._caller = Caller(
            session,
            config,
            lambda name: self._announce(EntityKind.CLIENT, name, QOS_RELIABLE_10),
        )
        self._tokens: list[Any] = [node_token]
        self.graph = graph

    @staticmethod
    def open(config: TransportConfig, node_name: str) -> Link:
        """Open a session.

        Args:
            config: Where to connect or listen.
            node_name: ROS 2 name of this node, without slashes.

        Raises:
            ConfigurationError: The Zenoh configuration file is missing or wrong.
            TransportError: The port is taken, nobody answers within `connect_timeout_s`, or the
                user's `ZENOH_RUNTIME` is nonsense.
        """
        zenoh_config = config.zenoh()
        try:
            session = zenoh.open(zenoh_config)
        except zenoh.ZError as error:
            raise _explain(error, config, zenoh_config) from error
        except BaseException as error:
            runtime.explain(error)
            raise
        node = ros2_keys.Node(config.domain, str(session.zid()), node_name)
        node_token = session.liveliness().declare_token(ros2_keys.node_token(node))
        return Link(session, config, node, node_token, Graph.watch(session, config.domain))

    @property
    def session_id(self) -> str:
        """Zenoh id of this session; `graph.session_of` gives the same for others."""
        return self._node.session

    def publisher(self, topic: Topic) -> Publisher:
        """Declare a publisher; its `put` is meant for the hot loop."""
        entity_gid = self._announce(EntityKind.PUBLISHER, topic, QOS_RELIABLE_10)
        congestion = zenoh.CongestionControl
        priority = zenoh.Priority
        publisher = self._session.declare_publisher(
            ros2_keys.data_key(self._config.domain, topic),
            congestion_control=congestion.BLOCK if self._config.lock_step else congestion.DROP,
            priority=priority.REAL_TIME if topic.command else priority.INTERACTIVE_HIGH,
            express=True,
        )
        self._declared.append(publisher)
        return Publisher(publisher, entity_gid)

    def subscribe(
        self, topic: Topic, depth: int | None = 1, senders: Senders | None = None
    ) -> LatestReader:
        """Subscribe to a topic.

        Args:
            topic: Which.
            depth: How many unread samples are kept, the newest; None keeps all (up to 10,000,
                then the oldest are dropped) for `drain`.
            senders: Who is believed; None believes everybody. Whoever believes few needs room for
                the messages of others, which are kept until they are looked at.
        """
        qos = QOS_BEST_EFFORT_1 if depth == 1 else QOS_RELIABLE_10
        self._announce(EntityKind.SUBSCRIPTION, topic, qos)
        room = _ALL if depth is None else depth
        subscriber = self._session.declare_subscriber(
            ros2_keys.data_key(self._config.domain, topic), zenoh.handlers.RingChannel(room)
        )
        self._declared.append(subscriber)
        believed = None if senders is None else senders.on(topic)
        return LatestReader(subscriber.handler, topic, room, believed)

    def service(self, name: ServiceName, handler: Handler, *, polled: bool = False) -> Service:
        """Serve a service.

        Args:
            name: Which.
            handler: Called with each request; what it returns is the reply, and what it
                raises as SkewmiError becomes an unsuccessful reply with that message.
            polled: Keep requests until `Service.poll` is called, and handle them in that
                thread; else handle them at once in a thread of their own.
        """
        self._announce(EntityKind.SERVICE, name, QOS_RELIABLE_10)
        queryable = self._session.declare_queryable(
            ros2_keys.data_key(self._config.domain, name),
            zenoh.handlers.RingChannel(64),
            complete=True,
        )
        self._declared.append(queryable)
        service = Service(handler, queryable.handler)
        if not polled:
            service.start()
        return service

    def call(
        self, name: ServiceName, timeout_s: float, request: bytes = b"", only: str = ""
    ) -> messages.TriggerReply:
        """Call a service and wait for its reply.

        Args:
            name: Which.
            timeout_s: How long to wait, s.
            request: Extra bytes behind the (empty) Trigger request, for our own robot servers.
            only: Zenoh id of the session whose answer counts; empty for the first that comes.

        Raises:
            TransportError: Nobody serves it, it did not answer in time, or not sensibly.
        """
        return self._caller.call(name, timeout_s, request, only)

    def call_all(
        self, name: ServiceName, timeout_s: float, request: bytes = b""
    ) -> list[messages.TriggerReply]:
        """Call a service of everybody who serves it; their replies, one of each session.

        Raises:
            TransportError: Nobody answers in time, or somebody not sensibly.
        """
        return self._caller.call_all(name, timeout_s, request)

    def wait_for_robot(self, timeout_s: float) -> dict[str, Any]:
        """Wait until a robot server describes itself.

        Returns:
            Its description, as served by `/yumi/describe`.

        Raises:
            TransportError: None answers in time, or what answers is not one of ours.
        """
        deadline = time.monotonic() + timeout_s
        while (remaining := deadline - time.monotonic()) > 0.0:
            try:
                reply = self.call(YUMI_DESCRIBE, min(remaining, 1.0))
            except TransportError:
                # An absent service is reported at once: ask again, but not in a tight loop.
                time.sleep(min(0.05, max(0.0, deadline - time.monotonic())))
                continue
            return _read_description(reply.message, self._config.where)
        raise TransportError(
            f"no robot server answers at {self._config.where} in ROS 2 domain "
            f"{self._config.domain} within {timeout_s:g} s; start one with `skewmi robot`, in the "
            "same domain (--domain, or ROS_DOMAIN_ID)"
        )

    def close(self) -> None:
        """Withdraw everything declared and close the session; safe to call twice."""
        if self._session.is_closed():
            return
        # Tokens first, so that nobody waits for the 10 s lease to learn that we are gone.
        for declared in (*self._tokens, *self._declared):
            declared.undeclare()
        self.graph.close()
        self._session.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _announce(self, kind: EntityKind, topic: Topic | ServiceName, qos: str) -> bytes:
        """Declare the liveliness token of a new entity; return its gid."""
        self._entities += 1
        token = ros2_keys.endpoint_token(self._node, self._entities, kind, topic, qos)
        self._tokens.append(self._session.liveliness().declare_token(token))
        return ros2_keys.gid(token)


def _read_description(text: str, where: str) -> dict[str, Any]:
    try:
        description = json.loads(text)
    except json.JSONDecodeError as error:
        raise TransportError(
            f"the robot server at {where} describes itself unreadably: {error}"
        ) from error
    if not isinstance(description, dict):
        raise TransportError(
            f"the robot server at {where} describes itself with "
            f"{text[:80]!r} instead of a JSON object"
        )
    return description


def _explain(error: Exception, config: TransportConfig, zenoh_config: Any) -> TransportError:
    text = str(error)
    where = ", ".join(zenoh_file.locators(zenoh_config, "connect")) or config.where
    if "in use" in text:
        for locator in zenoh_file.locators(zenoh_config, "listen"):
            protocol, _, address = locator.partition("/")
            host, _, port = address.rpartition(":")
            return TransportError(
                f"port {port} on {host} is in use: another server or a Zenoh router runs there; "
                f"stop it or use --listen {protocol}/{host}:PORT"
            )
    if "connect" in text.lower():
        reason = tls_diagnosis.why_not_connected(zenoh_config)
        if reason is not None:
            return TransportError(f"no secured link to {where}: {reason}")
        return TransportError(
            f"no robot server answers at {where} within {config.connect_timeout_s:g} s; "
            "start one with `skewmi robot`"
        )
    return TransportError(
        f"cannot open a Zenoh session at {config.where}: {zenoh_file.first_line(error)}"
    )
