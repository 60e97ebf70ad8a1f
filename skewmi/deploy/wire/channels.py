"""What a `Link` hands out: publisher, reader of the newest sample, served service."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import zenoh

from skewmi.deploy.wire import messages, ros2_keys
from skewmi.deploy.wire.senders import TopicSenders
from skewmi.deploy.wire.topics import Topic
from skewmi.errors import SkewmiError, TransportError

_log = logging.getLogger(__name__)

_POLL_S = 20e-6
"""Sleep between two looks at an empty channel; the kernel makes about 80 us of it."""

_MOST_AT_ONCE = 8
"""Requests that one `Service.poll` answers: whoever asks without end must not keep it there."""


@dataclass(frozen=True)
class Sample:
    """A received message."""

    payload: bytes
    sequence: int
    """The publisher's count, from 1; a gap means lost messages."""
    source_time_ns: int
    """Publisher's wall clock when it sent, ns since 1970."""
    gid: bytes
    """The publisher's global id, 16 bytes."""
    received_ns: int
    """`time.monotonic_ns` when it was taken out of the channel."""


@dataclass(frozen=True)
class Request:
    """A received service request."""

    extra: bytes
    """Bytes behind the Trigger request; empty from ROS 2 nodes."""
    gid: bytes
    """The client's global id; all zero if it sent none."""


Handler = Callable[[Request], messages.TriggerReply]


class Publisher:
    """Sends payloads on one topic."""

    def __init__(self, publisher: Any, entity_gid: bytes) -> None:
        self._publisher = publisher
        self.gid = entity_gid
        """Global id of this publisher, as receivers see it."""
        self.sequence = 0
        """Number of payloads sent."""

    def put(self, payload: bytes) -> None:
        """Send; returns at once in real time, may block in lock-step.

        Raises:
            TransportError: The session is closed.
        """
        self.sequence += 1
        attachment = ros2_keys.encode_attachment(self.sequence, time.time_ns(), self.gid)
        try:
            self._publisher.put(payload, attachment=attachment)
        except zenoh.ZError as error:
            raise TransportError(f"cannot publish: {error}") from error


class LatestReader:
    """The receiving end of a topic. Nothing here blocks but `wait`.

    Args:
        handler: Of the Zenoh subscriber.
        topic: What it subscribes to.
        most: Messages that one look takes in or leaves out; the rest waits for the next.
        senders: Who is believed; None believes everybody.
    """

    def __init__(
        self, handler: Any, topic: Topic, most: int, senders: TopicSenders | None = None
    ) -> None:
        self._handler = handler
        self._topic = topic
        self._most = most
        self._senders = senders
        self._latest: Sample | None = None

    def latest(self) -> Sample | None:
        """Newest sample ever received, new or not; None if there was none."""
        self.take()
        return self._latest

    def take(self) -> Sample | None:
        """Newest sample if there is one that was not taken before, else None."""
        samples = self.drain()
        return samples[-1] if samples else None

    def drain(self) -> list[Sample]:
        """All unread samples, oldest first.

        Those without a proper attachment are left out, and those of senders that are not believed.
        """
        samples: list[Sample] = []
        for _ in range(self._most):
            received = self._handler.try_recv()
            if received is None:
                break
            sample = _sample(received, self._senders)
            if sample is not None:
                samples.append(sample)
        if samples:
            self._latest = samples[-1]
        return samples

    def others(self) -> str:
        """Who else publishes here without being believed, to end a complaint with."""
        return "" if self._senders is None else self._senders.words()

    def wait(self, timeout_s: float) -> Sample:
        """Wait for a sample that was not taken before; return the newest.

        Raises:
            TransportError: None came in time.
        """
        deadline = time.monotonic() + timeout_s
        while (sample := self.take()) is None:
            if time.monotonic() > deadline:
                raise TransportError(f"no message on {self._topic.name} within {timeout_s:g} s")
            time.sleep(_POLL_S)
        return sample


class Service:
    """The serving end of a service."""

    def __init__(self, handler: Handler, queries: Any) -> None:
        self._handler = handler
        self._queries = queries

    def start(self) -> None:
        """Answer requests at once, in a thread of their own; else `poll` answers them."""
        # Not a Zenoh callback: their threads keep the interpreter from exiting.
        threading.Thread(target=self._serve, name="skewmi-service", daemon=True).start()

    def poll(self) -> int:
        """Answer waiting requests in the calling thread, the next eight at most; how many."""
        answered = 0
        while answered < _MOST_AT_ONCE and (query := self._queries.try_recv()) is not None:
            self._answer(query)
            answered += 1
        return answered

    def _serve(self) -> None:
        try:
            for query in self._queries:
                self._answer(query)
        except zenoh.ZError:
            return  # the session was closed

    def _answer(self, query: Any) -> None:
        """Answer one Zenoh query. Nothing escapes: a failure becomes an unsuccessful reply."""
        attachment = query.attachment.to_bytes() if query.attachment is not None else b""
        try:
            sequence, _, client = ros2_keys.decode_attachment(attachment)
        except TransportError:
            sequence, client = 0, bytes(16)
        try:
            payload = query.payload.to_bytes() if query.payload is not None else b""
            extra = messages.decode_trigger_request(payload)
            reply = self._handler(Request(extra, client))
        except SkewmiError as error:
            reply = messages.TriggerReply(False, str(error))
        except Exception as error:
            # A bug in a handler must not leave the caller waiting.
            _log.exception("service handler failed")
            reply = messages.TriggerReply(False, f"internal error: {error!r}")
        # A reply repeats the request's sequence and client: that is how rmw matches them.
        query.reply(
            query.key_expr,
            messages.encode_trigger_reply(reply),
            express=True,
            attachment=ros2_keys.encode_attachment(sequence, time.time_ns(), client),
        )
        query.drop()


def _sample(received: Any, senders: TopicSenders | None) -> Sample | None:
    attachment = received.attachment
    # Its length before its bytes: a long one is not worth copying.
    if attachment is None or len(attachment) > ros2_keys.ATTACHMENT_BYTES:
        return None
    try:
        sequence, source_time_ns, gid = ros2_keys.decode_attachment(attachment.to_bytes())
    except TransportError:
        return None
    if senders is not None and not senders.admit(gid, sequence):
        return None
    payload = received.payload.to_bytes()
    return Sample(payload, sequence, source_time_ns, gid, received_ns=time.monotonic_ns())
