"""The robot server's states: what a robot does with commands, and what makes it stop."""

from __future__ import annotations

from enum import Enum

from skewmi.deploy.state_machine import TransitionTable


class ServerState(Enum):
    DISARMED = "disarmed"
    """At rest; every command is refused until somebody arms."""
    HOLDING = "holding"
    """Armed and at rest: the next valid chunk moves the arm."""
    EXECUTING = "executing"
    """Following the accepted chunks; runs out at rest by itself if nothing newer comes."""
    STOPPING = "stopping"
    """Running the braking tail of the last accepted chunk; commands are refused."""
    FAULT = "fault"
    """The robot itself reported trouble; commands are refused until it is acknowledged."""


class ServerEvent(Enum):
    ARM = "arm"
    """Somebody asked to arm."""
    CHUNK = "chunk"
    """A chunk passed every check."""
    AT_REST = "at rest"
    """The accepted plan has been followed to its end."""
    STOP = "stop"
    """Somebody asked to stop; in fault it acknowledges the fault."""
    DISARM = "disarm"
    """The commander gives the arm back; in fault it acknowledges nothing."""
    COMMANDER_LOST = "commander lost"
    """The commander has been silent for longer than its lease."""
    WITHDRAWN = "withdrawn"
    """The robot is not ready any more, and rests: whoever commanded it has to arm again."""
    FAULT = "fault"
    """The backend cannot follow: physics, drives or tracking."""


_S, _E = ServerState, ServerEvent

SERVER_TABLE = TransitionTable(
    _S.DISARMED,
    {
        (_S.DISARMED, _E.ARM): _S.HOLDING,
        (_S.DISARMED, _E.FAULT): _S.FAULT,
        (_S.HOLDING, _E.CHUNK): _S.EXECUTING,
        (_S.HOLDING, _E.STOP): _S.DISARMED,
        (_S.HOLDING, _E.DISARM): _S.DISARMED,
        (_S.HOLDING, _E.COMMANDER_LOST): _S.DISARMED,
        (_S.HOLDING, _E.WITHDRAWN): _S.DISARMED,
        (_S.HOLDING, _E.FAULT): _S.FAULT,
        (_S.EXECUTING, _E.AT_REST): _S.HOLDING,
        (_S.EXECUTING, _E.STOP): _S.STOPPING,
        (_S.EXECUTING, _E.DISARM): _S.STOPPING,
        (_S.EXECUTING, _E.COMMANDER_LOST): _S.STOPPING,
        (_S.EXECUTING, _E.FAULT): _S.FAULT,
        (_S.STOPPING, _E.AT_REST): _S.DISARMED,
        (_S.STOPPING, _E.FAULT): _S.FAULT,
        (_S.FAULT, _E.STOP): _S.DISARMED,
    },
)

ACCEPTS_COMMANDS = frozenset({_S.HOLDING, _S.EXECUTING})
"""States in which chunks are looked at; in all others they are refused."""
