"""What the bridge knows of its controller, as a state machine: what it does with each packet."""

from __future__ import annotations

from enum import Enum

from skewmi.deploy.state_machine import TransitionTable


class EgmState(Enum):
    SILENT = "silent"
    """No packet of a controller for 0.1 s: nothing is sent, nobody can arm."""
    REFUSED = "refused"
    """Packets come, but of no controller that can be answered: none is."""
    FOLLOWING = "following"
    """The controller does not follow references (motors, program or EGM are off, somebody guides
    the arm by hand): every reference is where the arm is."""
    RAMPING = "ramping"
    """It follows references, but not fully yet: hold where the session began."""
    GUIDING = "guiding"
    """It follows references: the accepted plan is sent."""
    OVERLOADED = "overloaded"
    """It follows them in part, because they ask for more than the joints can do."""


class EgmEvent(Enum):
    UNUSABLE = "unusable packet"
    """A packet that is not of a controller, or of one that is too old."""
    NOT_GUIDED = "packet, not guided"
    """A packet of a controller that does not follow references."""
    SESSION = "session begins"
    """A packet of one that does, and a session begins with it."""
    RAMPED = "ramp over"
    """The session has lasted for the time the program gives to come up to full tracking."""
    OVERLOAD = "overload"
    """More than 100 % of the joints' abilities were asked for, for longer than a peak."""
    RELIEF = "relief"
    """What is asked for is within the joints' abilities again."""
    SILENCE = "silence"
    """No packet for 0.1 s, or the session is known to be over."""


_S, _E = EgmState, EgmEvent
_ALIVE = (_S.FOLLOWING, _S.RAMPING, _S.GUIDING, _S.OVERLOADED)

EGM_TABLE = TransitionTable(
    _S.SILENT,
    {
        (_S.SILENT, _E.UNUSABLE): _S.REFUSED,
        (_S.REFUSED, _E.SILENCE): _S.SILENT,
        (_S.RAMPING, _E.RAMPED): _S.GUIDING,
        (_S.GUIDING, _E.OVERLOAD): _S.OVERLOADED,
        (_S.OVERLOADED, _E.RELIEF): _S.GUIDING,
        **{(state, _E.SILENCE): _S.SILENT for state in _ALIVE},
        **{(state, _E.NOT_GUIDED): _S.FOLLOWING for state in (_S.SILENT, _S.REFUSED, *_ALIVE)},
        **{(state, _E.SESSION): _S.RAMPING for state in (_S.SILENT, _S.REFUSED, *_ALIVE)},
    },
)
