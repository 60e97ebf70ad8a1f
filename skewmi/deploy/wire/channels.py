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


class Sample:
    """A received message. Its payload is copied out of the link when it is first asked for.

    Args:
        payload: Bytes, or Zenoh's.
        sequence: The publisher's count, from 1; a gap means lost messages.
        source_time_ns: Publisher's wall clock when it sent, ns since 1970.
        gid: The publisher's global id, 16 bytes.
        received_ns: `time.monotonic_ns` when it was taken out of the channel.
    """

    __slots__ = ("_payload", "gid", "received_ns", "sequence", "source_time_ns")

    def __init__(
        self, payload: Any, sequence: int, source_time_ns: int, gid: bytes, received_ns: int
    ) -> None:
        self._payload = payload
        self.sequence = sequence
        self.source_time_ns = source_time_ns
        self.gid = gid
        self.received_ns = received_ns

    @property
    def size(self) -> int:
        """Length of the payload, bytes; costs nothing."""
        return len(self._payload)

    @property
    def payload(self) -> bytes:
        if not isinstance(self._payload, bytes):
            self._payload = self._payload.to_bytes()
        payload: bytes = self._payload
        return payload


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
        self.strays = 0
        """Messages that were left out because they do not tell who sent them."""

    def latest(self) -> Sample | None:
        """Newest sample ever received, new or not; None if there was none."""
        self.take()
        return self._latest

    def take(self) -> Sample | None:
        """Newest sample if there is one that was not taken before, else None."""
        samples = self.drain()
        return samples[-1] if samples else None

    def drain(self, most: int | None = None) -> list[Sample]:
        """All unread samples, oldest first.

        Those without a proper attachment are left out, and those of senders that are not believed.

        Args:
            most: Messages that are taken at most, those left out included; None for as many as
                the reader was made for. A loop that must keep its time names a number: senders may
                be faster than it.
        """
        samples: list[Sample] = []
        for _ in range(self._most if most is None else most):
            received = self._handler.try_recv()
            if received is None:
                break
            attachment = _attachment(received)
            if attachment is None:
                self.strays += 1
                continue
            sequence, source_time_ns, gid = attachment
            if self._senders is not None and not self._senders.admit(gid, sequence):
                continue
            now_ns = time.monotonic_ns()
            samples.append(
                Sample(received.payload, sequence, source_time_ns, gid, received_ns=now_ns)
            )
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
    """The serving end of a service.

    Args:
        handler: Answers a request.
        queries: Where requests wait.
    """

    def __init__(self, handler: Handler, queries: Any) -> None:
        self._handler = handler
        self._queries = queries
        self.longest: int | None = None
        """Bytes that a request may have; a longer one is refused unread. None for any."""

    def start(self) -> None:
        """Answer requests at once, in a thread of their own; else `poll` answers them."""
        # Not a Zenoh callback: their threads keep the interpreter from exiting.
        threading.Thread(target=self._serve, name="skewmi-service", daemon=True).start()

    def poll(self, until_ns: int | None = None) -> int:
        """Answer waiting requests in the calling thread, the next eight at most; how many.

        Args:
            until_ns: After this time (`time.monotonic_ns`) no further one is begun, but one is
                answered whatever the time; None for no such end.
        """
        answered = 0
        while answered < _MOST_AT_ONCE and (query := self._queries.try_recv()) is not None:
            self._answer(query)
            answered += 1
            if until_ns is not None and time.monotonic_ns() > until_ns:
                break
        return answered

    def _serve(self) -> None:
        try:
            for query in self._queries:
                self._answer(query)
        except zenoh.ZError:
            return  # the session was closed

    def _answer(self, query: Any) -> None:
        """Answer one Zenoh query. Nothing escapes: a failure becomes an unsuccessful reply."""
        sequence, _, client = _attachment(query) or (0, 0, bytes(16))
        try:
            size = 0 if query.payload is None else len(query.payload)
            if self.longest is not None and size > self.longest:
                raise TransportError(
                    f"the request has {size} bytes; at most {self.longest} are read"
                )
            payload = query.payload.to_bytes() if size else b""
            extra = messages.decode_trigger_request(payload)
            reply = self._handler(Request(extra, client))
        except SkewmiError as error:
            reply = messages.TriggerReply(False, str(error) or type(error).__name__)
        except Exception as error:
            # A bug in a handler must not leave the caller waiting. One line: a traceback would be
            # put together, and the sources be read for it, by a loop that has no time.
            _log.error("a service's handler failed: %r in %s", error, _place(error))
            reply = messages.TriggerReply(False, f"internal error: {error!r}")
        # A reply repeats the request's sequence and client: that is how rmw matches them.
        query.reply(
            query.key_expr,
            messages.encode_trigger_reply(reply),
            express=True,
            attachment=ros2_keys.encode_attachment(sequence, time.time_ns(), client),
        )
        query.drop()


def _attachment(received: Any) -> tuple[int, int, bytes] | None:
    """Sequence, wall clock and gid of a sample's or request's sender; None if it does not tell."""
    attachment = received.attachment
    if attachment is None or len(attachment) != ros2_keys.ATTACHMENT_BYTES:
        return None
    try:
        return ros2_keys.decode_attachment(attachment.to_bytes())
    except TransportError:
        return None


def _place(error: Exception) -> str:
    """File and line where an error was raised."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "?" if trace is None else f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}"
