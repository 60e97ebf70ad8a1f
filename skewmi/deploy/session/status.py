"""The session's state, and how others learn of it."""

from __future__ import annotations

import logging
from dataclasses import replace

from skewmi.deploy.session.news import SessionNews
from skewmi.deploy.session.states import SESSION_TABLE, SessionEvent, SessionState
from skewmi.deploy.state_machine import StateMachine, Transition
from skewmi.deploy.wire.channels import Publisher
from skewmi.deploy.wire.senders import Stranger
from skewmi.errors import TransportError

_MOST_NAMED = 16
"""Strangers that a status names."""

_log = logging.getLogger(__name__)


class SessionStatus:
    """The session's state machine; every change of state is logged and published.

    Args:
        publisher: Of `topics.YUMI_STATUS`.
    """

    def __init__(self, publisher: Publisher) -> None:
        self.clock_ns = 0
        """The newest stamp of the robot server that the session has seen."""
        self._publisher = publisher
        self._strangers: list[str] = []
        self._last: SessionNews | None = None
        self._machine = StateMachine(SESSION_TABLE, self._tell)

    @property
    def state(self) -> SessionState:
        return self._machine.state

    @property
    def reason(self) -> str:
        """Why the session is in its state."""
        return self._machine.reason

    def fire(self, event: SessionEvent, reason: str) -> None:
        """Let an event act."""
        self._machine.fire(event, reason, self.clock_ns)

    def tell_strangers(self, strangers: list[Stranger]) -> None:
        """Name senders that are not believed: at once, and in whatever is told from now on."""
        names = [str(stranger) for stranger in strangers]
        self._strangers = [*self._strangers, *names][:_MOST_NAMED]
        if self._last is not None:
            self._publish(replace(self._last, stamp_ns=self.clock_ns, strangers=self._named))

    @property
    def _named(self) -> str:
        return "; ".join(self._strangers)

    def _tell(self, transition: Transition[SessionState]) -> None:
        _log.info("%s", transition)
        self._last = SessionNews(
            transition.stamp_ns,
            transition.target,
            transition.reason,
            transition.source,
            SessionEvent(transition.event),
            self._named,
        )
        self._publish(self._last)

    def _publish(self, news: SessionNews) -> None:
        try:
            self._publisher.put(news.encode())
        except TransportError:
            _log.warning("cannot report %s: %s", news.state.value, news.reason)
