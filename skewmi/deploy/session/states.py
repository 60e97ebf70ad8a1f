"""The session's states: from looking for a robot to holding still again."""

from __future__ import annotations

from enum import Enum

from skewmi.deploy.state_machine import TransitionTable
from skewmi.deploy.wire import session_status

STATUS_NAME = session_status.NAME
"""Name under which the session tells its states."""


class SessionState(Enum):
    CONNECTING = "connecting"
    """Waiting for a robot server to answer."""
    PREFLIGHT = "preflight"
    """Comparing layout, robot model and limits; resetting a simulated scene; arming."""
    TO_START = "to start"
    """Moving to the pose the episode starts from."""
    RUNNING = session_status.RUNNING
    """The policy commands the hand."""
    SUCCESS = "success"
    """The task is solved; the arm brakes."""
    TIME_OVER = "time over"
    """The episode's steps are used up; the arm brakes."""
    STOPPING = "stopping"
    """Somebody or a limit stopped the episode; the arm brakes."""
    FAULT = "fault"
    """Something is broken; the arm brakes and no further episode starts."""
    HOLDING = "holding"
    """At rest between episodes."""
    DONE = "done"
    """No more episodes; the robot server is disarmed."""


class SessionEvent(Enum):
    CONNECTED = "connected"
    READY = "ready"
    AT_START = "at start"
    SUCCESS = "success"
    TIME_OVER = "time over"
    STOP = "stop"
    FAULT = "fault"
    AT_REST = "at rest"
    NEXT_EPISODE = "next episode"
    FINISH = "finish"


_S, _E = SessionState, SessionEvent

BRAKING = frozenset({_S.SUCCESS, _S.TIME_OVER, _S.STOPPING, _S.FAULT})
"""States in which nothing new is published: the tail already at the robot server brakes the arm."""

SESSION_TABLE = TransitionTable(
    _S.CONNECTING,
    {
        (_S.CONNECTING, _E.CONNECTED): _S.PREFLIGHT,
        (_S.PREFLIGHT, _E.READY): _S.TO_START,
        (_S.TO_START, _E.AT_START): _S.RUNNING,
        (_S.RUNNING, _E.SUCCESS): _S.SUCCESS,
        (_S.RUNNING, _E.TIME_OVER): _S.TIME_OVER,
        **{(state, _E.STOP): _S.STOPPING for state in (_S.PREFLIGHT, _S.TO_START, _S.RUNNING)},
        **{
            (state, _E.FAULT): _S.FAULT
            for state in _S
            if state not in (_S.FAULT, _S.HOLDING, _S.DONE)
        },
        **{(state, _E.AT_REST): _S.HOLDING for state in BRAKING},
        (_S.HOLDING, _E.NEXT_EPISODE): _S.PREFLIGHT,
        (_S.HOLDING, _E.FINISH): _S.DONE,
    },
)
