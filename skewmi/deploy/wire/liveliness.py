"""Who is on the link: the liveliness tokens of all nodes, kept up to date by Zenoh.

A sample carries only its publisher's gid; the token it is the hash of also names the session and
the node, and its end tells that they have left. A crashed process may keep its tokens for the ten
seconds of Zenoh's lease, and who may publish tokens may publish false ones: this is bookkeeping,
no watchdog and no proof of identity.
"""

from __future__ import annotations

import threading
from typing import Any

import zenoh

from skewmi.deploy.wire import ros2_keys
from skewmi.deploy.wire.topics import Topic

MAX_TOKENS = 10_000
MAX_TOKEN = 1_000
"""Tokens that are remembered, and characters of each: whoever declares more has bad intentions."""


class Graph:
    """Tokens alive in one ROS 2 domain. Thread-safe.

    Args:
        subscriber: A Zenoh subscriber to the domain's tokens, past ones included, as `watch` makes.
    """

    def __init__(self, subscriber: Any) -> None:
        self._lock = threading.Lock()
        self._session_of: dict[bytes, str] = {}
        self._node_of: dict[bytes, str] = {}
        self._tokens: dict[str, bytes] = {}
        self._subscriber = subscriber

    @staticmethod
    def watch(session: Any, domain: int) -> Graph:
        """Listen to the tokens of a domain on an open Zenoh session."""
        # A channel drained on demand, not a callback: Zenoh runs callbacks in a thread that
        # keeps the interpreter from exiting while the session is open.
        subscriber = session.liveliness().declare_subscriber(
            f"{ros2_keys.ADMIN_SPACE}/{domain}/**",
            zenoh.handlers.RingChannel(10_000),
            history=True,
        )
        return Graph(subscriber)

    def session_of(self, entity_gid: bytes) -> str | None:
        """Zenoh id of the session an entity lives in; None if it is not (or no longer) there."""
        with self._lock:
            self._update()
            return self._session_of.get(entity_gid)

    def node_of(self, entity_gid: bytes) -> str:
        """Name of the node an entity belongs to; empty if it is not (or no longer) there."""
        with self._lock:
            self._update()
            return self._node_of.get(entity_gid, "")

    def publishers(self, topic: Topic) -> dict[bytes, str]:
        """Global ids of the publishers that are announced on a topic, and their nodes' names."""
        with self._lock:
            self._update()
            return {
                gid: ros2_keys.node_of_token(token)
                for token, gid in self._tokens.items()
                if ros2_keys.is_token_of(token, ros2_keys.EntityKind.PUBLISHER, topic)
            }

    def tokens(self) -> tuple[str, ...]:
        """All tokens alive, sorted."""
        with self._lock:
            self._update()
            return tuple(sorted(self._tokens))

    def close(self) -> None:
        """Stop listening."""
        self._subscriber.undeclare()

    def _update(self) -> None:
        while (sample := self._subscriber.handler.try_recv()) is not None:
            token = str(sample.key_expr)
            gid = ros2_keys.gid(token)
            if sample.kind != zenoh.SampleKind.PUT:
                self._tokens.pop(token, None)
                self._session_of.pop(gid, None)
                self._node_of.pop(gid, None)
            elif len(self._tokens) < MAX_TOKENS and len(token) <= MAX_TOKEN:
                self._tokens[token] = gid
                self._session_of[gid] = ros2_keys.session_of_token(token)
                self._node_of[gid] = ros2_keys.node_of_token(token)
