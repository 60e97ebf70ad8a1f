"""What the program of one arm does on the emulated controller, as a state machine.

It is the program of `rapid/SkewmiEgm.mod`: move to a fine point, prepare EGM, let it run until it
ends, and start over. Motors and program can be switched from outside, as on a FlexPendant.
"""

from __future__ import annotations

from enum import Enum

from skewmi.deploy.robot.backends.egm.packets import Mci, Rapid
from skewmi.deploy.state_machine import TransitionTable


class ArmState(Enum):
    STOPPED = "program stopped"
    """The program does not run, and EGM is not active: no packets."""
    PREPARING = "preparing"
    """`MoveAbsJ` to a fine point, EGMGetId, EGMSetupUC: no packets yet."""
    ACTIVATED = "activated"
    """After EGMActJoint: packets come, references are not followed."""
    GUIDED = "guided"
    """EGMRunJoint: references are followed."""
    SUSPENDED = "suspended"
    """Program or motors went off during EGMRunJoint: packets come, and it may go on."""
    ENDING = "ending"
    """EGMRunJoint has ended (converged, or nothing came): the arm comes to rest, EGMReset."""
    FAILED = "failed"
    """An error that the program does not handle: it stands still until somebody starts it."""
    DOWN = "down"
    """System failure: no packets, no program until the controller is restarted."""


class ArmEvent(Enum):
    START = "program start"
    """Somebody starts the program, with motors on."""
    STOP = "program stop"
    """Somebody stops it."""
    MOTORS_OFF = "motors off"
    """Motors go off while EGM may go on afterwards (Do Not Restart after Motors Off: False)."""
    MOTORS_OFF_FINAL = "motors off for good"
    """The same with that parameter True."""
    READY = "EGM ready"
    """The arm stands at a fine point and EGM is set up."""
    RUN = "EGMRunJoint"
    """The program has come to it."""
    CONVERGED = "converged"
    """All joints were within the convergence limits for CondTime."""
    COMM_TIMEOUT = "no answer"
    """Nothing came for CommTimeout: ERR_UDPUC_COMM, which the program handles."""
    OUT_OF_RANGE = "out of range"
    """A reference outside of an axis' range: the session ends with an error."""
    NOT_FINITE = "not a number"
    """A reference that is none: 10014, system failure state."""
    AT_REST = "at rest"
    """The arm has come to rest after the end of EGMRunJoint."""
    RESTART = "controller restart"
    """Somebody restarts the controller."""


_S, _E = ArmState, ArmEvent

ARM_TABLE = TransitionTable(
    _S.STOPPED,
    {
        (_S.STOPPED, _E.START): _S.PREPARING,
        (_S.FAILED, _E.START): _S.PREPARING,
        (_S.SUSPENDED, _E.START): _S.GUIDED,
        (_S.PREPARING, _E.READY): _S.ACTIVATED,
        (_S.ACTIVATED, _E.RUN): _S.GUIDED,
        (_S.GUIDED, _E.CONVERGED): _S.ENDING,
        (_S.GUIDED, _E.COMM_TIMEOUT): _S.ENDING,
        (_S.GUIDED, _E.OUT_OF_RANGE): _S.FAILED,
        (_S.GUIDED, _E.NOT_FINITE): _S.DOWN,
        (_S.GUIDED, _E.STOP): _S.SUSPENDED,
        (_S.GUIDED, _E.MOTORS_OFF): _S.SUSPENDED,
        (_S.ENDING, _E.AT_REST): _S.PREPARING,
        **{
            (state, event): _S.STOPPED
            for state in (_S.PREPARING, _S.ACTIVATED, _S.ENDING)
            for event in (_E.STOP, _E.MOTORS_OFF, _E.MOTORS_OFF_FINAL)
        },
        (_S.GUIDED, _E.MOTORS_OFF_FINAL): _S.STOPPED,
        (_S.SUSPENDED, _E.MOTORS_OFF_FINAL): _S.STOPPED,
        **{(state, _E.RESTART): _S.STOPPED for state in ArmState if state is not ArmState.STOPPED},
    },
)

SENDING = frozenset({_S.ACTIVATED, _S.GUIDED, _S.SUSPENDED, _S.ENDING, _S.FAILED})
"""States in which packets are sent."""

_RUNNING = frozenset({_S.PREPARING, _S.ACTIVATED, _S.GUIDED, _S.ENDING})


def mci_of(state: ArmState) -> Mci:
    """What a packet says of the motion correction."""
    if state is ArmState.FAILED:
        return Mci.ERROR
    return Mci.RUNNING if state is ArmState.GUIDED else Mci.STOPPED


def rapid_of(state: ArmState) -> Rapid:
    """What a packet says of the program."""
    return Rapid.RUNNING if state in _RUNNING else Rapid.STOPPED
