"""The session's state, and how others learn of it."""

from __future__ import annotations

import logging

from skewmi.deploy.session.news import SessionNews
from skewmi.deploy.session.states import SESSION_TABLE, SessionEvent, SessionState
from skewmi.deploy.state_machine import StateMachine, Transition
from skewmi.deploy.wire.channels import Publisher
from skewmi.errors import TransportError

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

    def _tell(self, transition: Transition[SessionState]) -> None:
        _log.info("%s", transition)
        news = SessionNews(
            transition.stamp_ns,
            transition.target,
            transition.reason,
            transition.source,
            SessionEvent(transition.event),
        )
        try:
            self._publisher.put(news.encode())
        except TransportError:
            _log.warning("cannot report %s", transition)
