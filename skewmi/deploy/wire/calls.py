"""Calling services: of whoever answers first, of one robot server alone, or of everybody."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NoReturn

import zenoh

from skewmi.deploy.wire import messages, ros2_keys, zenoh_file
from skewmi.deploy.wire.messages import TriggerReply
from skewmi.deploy.wire.topics import Service
from skewmi.deploy.wire.transport_config import TransportConfig
from skewmi.errors import TransportError

_OTHERS_S = 1.0
"""After a first answer, others are waited for so long, unless Zenoh knows that there are none."""

_POLL_S = 0.001
_MOST_ANSWERS = 16


class Caller:
    """The calling end of all services of a link.

    Args:
        session: An open Zenoh session.
        config: What it was opened with.
        announce: Declares a client of a service on the link, and returns its global id.
    """

    def __init__(
        self, session: Any, config: TransportConfig, announce: Callable[[Service], bytes]
    ) -> None:
        self._session = session
        self._config = config
        self._announce = announce
        self._clients: dict[str, tuple[bytes, int]] = {}

    def call(
        self, name: Service, timeout_s: float, request: bytes = b"", only: str = ""
    ) -> TriggerReply:
        """Call a service and wait for its reply.

        Args:
            name: Which.
            timeout_s: How long to wait, s.
            request: Extra bytes behind the (empty) Trigger request.
            only: Zenoh id of the session whose answer counts; empty for the first that comes.

        Raises:
            TransportError: Nobody serves it, it did not answer in time, or not sensibly.
        """
        others = 0
        try:
            for reply in self._ask(name, timeout_s, request):
                if reply.ok is None:
                    continue
                replier = _replier(reply)
                if only in ("", replier):
                    return _decode(reply, replier)
                others += 1
        except zenoh.ZError as error:
            raise TransportError(
                f"cannot call {name.name}: {zenoh_file.first_line(error)}"
            ) from error
        self._no_answer(name, timeout_s, others)

    def call_all(self, name: Service, timeout_s: float, request: bytes = b"") -> list[TriggerReply]:
        """Call a service of everybody who serves it; their replies, one of each session.

        Args:
            name: Which.
            timeout_s: How long to wait for the first, s.
            request: Extra bytes behind the (empty) Trigger request.

        Raises:
            TransportError: Nobody answers in time, or somebody not sensibly.
        """
        found: dict[str, TriggerReply] = {}
        until_s = time.monotonic() + timeout_s
        try:
            answers = self._ask(name, timeout_s, request)
            while time.monotonic() < until_s and len(found) < _MOST_ANSWERS:
                reply = answers.try_recv()
                if reply is None:
                    time.sleep(_POLL_S)
                elif reply.ok is not None:
                    replier = _replier(reply)
                    until_s = until_s if found else min(until_s, time.monotonic() + _OTHERS_S)
                    found.setdefault(replier, _decode(reply, replier))
        except zenoh.ZError as error:
            # That is how the end of all answers is told, too.
            if not found and self._session.is_closed():
                raise TransportError(
                    f"cannot call {name.name}: {zenoh_file.first_line(error)}"
                ) from error
        if not found:
            self._no_answer(name, timeout_s, 0)
        return list(found.values())

    def _ask(self, name: Service, timeout_s: float, request: bytes) -> Any:
        gid, sequence = self._clients.get(name.name, (b"", 0))
        if not gid:
            gid = self._announce(name)
        sequence += 1
        self._clients[name.name] = (gid, sequence)
        return self._session.get(
            ros2_keys.data_key(self._config.domain, name),
            zenoh.handlers.FifoChannel(_MOST_ANSWERS),
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout_s,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
            payload=messages.encode_trigger_request(request),
            attachment=ros2_keys.encode_attachment(sequence, time.time_ns(), gid),
        )

    def _no_answer(self, name: Service, timeout_s: float, others: int) -> NoReturn:
        where = f"at {self._config.where} in ROS 2 domain {self._config.domain}"
        if others:
            raise TransportError(
                f"no answer from {name.name} {where} of the robot server that this run began "
                "with; another one answers: it was restarted, or there are two. Run again"
            )
        raise TransportError(f"no answer from {name.name} {where} within {timeout_s:g} s")


def _replier(reply: Any) -> str:
    """Zenoh id of the session that answered; empty where Zenoh does not tell."""
    replier = getattr(reply, "replier_id", None)
    return "" if replier is None else str(replier.zid)


def _decode(reply: Any, replier: str) -> TriggerReply:
    decoded = messages.decode_trigger_reply(reply.ok.payload.to_bytes())
    return TriggerReply(decoded.success, decoded.message, replier)
