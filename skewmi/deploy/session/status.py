"""The session's state, and how others learn of it."""

from __future__ import annotations

import logging

from skewmi.deploy.session.states import (
    SESSION_TABLE,
    STATUS_NAME,
    SessionEvent,
    SessionState,
)
from skewmi.deploy.state_machine import StateMachine, Transition
from skewmi.deploy.wire.channels import Publisher
from skewmi.deploy.wire.messages import ERROR, OK, WARN, Status, encode_status
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
        level = {SessionState.FAULT: ERROR, SessionState.STOPPING: WARN}.get(transition.target, OK)
        values = {
            "state": transition.target.value,
            "reason": transition.reason,
            "from": transition.source.value,
            "event": transition.event,
        }
        message = f"{transition.target.value}: {transition.reason}"
        status = Status(transition.stamp_ns, STATUS_NAME, level, message, values)
        try:
            self._publisher.put(encode_status(status))
        except TransportError:
            _log.warning("cannot report %s", transition)
