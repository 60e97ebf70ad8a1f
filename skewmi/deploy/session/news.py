"""What a session says of itself on `/yumi/status`: the same type on both ends of the wire."""

from __future__ import annotations

from dataclasses import dataclass

from skewmi.deploy.session.states import STATUS_NAME, SessionEvent, SessionState
from skewmi.deploy.wire import session_status
from skewmi.deploy.wire.messages import (
    ERROR,
    OK,
    WARN,
    Status,
    decode_status,
    encode_status,
)
from skewmi.errors import TransportError

_LEVELS = {SessionState.FAULT: ERROR, SessionState.STOPPING: WARN}


@dataclass(frozen=True)
class SessionNews:
    """A change of a session's state."""

    stamp_ns: int
    """The newest stamp of the robot server that the session has seen."""
    state: SessionState
    """The new one."""
    reason: str
    source: SessionState
    """The state before."""
    event: SessionEvent
    """What changed it."""
    strangers: str = ""
    """Who publishes on topics of the robot server without being it, in words."""

    def encode(self) -> bytes:
        """diagnostic_msgs/DiagnosticArray with one entry."""
        values = {
            session_status.STATE: self.state.value,
            "reason": self.reason,
            "from": self.source.value,
            "event": self.event.value,
        }
        if self.strangers:
            values["strangers"] = self.strangers
        message = f"{self.state.value}: {self.reason}"
        level = _LEVELS.get(self.state, WARN if self.strangers else OK)
        return encode_status(Status(self.stamp_ns, STATUS_NAME, level, message, values))

    @staticmethod
    def decode(payload: bytes) -> SessionNews | None:
        """Inverse of `encode`; None if the message tells of somebody else.

        Raises:
            TransportError: Not a status, or not of a session of this version.
        """
        status = decode_status(payload)
        if status.name != STATUS_NAME:
            return None
        try:
            return SessionNews(
                status.stamp_ns,
                SessionState(status.values[session_status.STATE]),
                status.values["reason"],
                SessionState(status.values["from"]),
                SessionEvent(status.values["event"]),
                status.values.get("strangers", ""),
            )
        except (KeyError, ValueError) as error:
            raise TransportError(
                f"the session's status cannot be read ({error}); is it of another version of "
                "skewmi?"
            ) from error
