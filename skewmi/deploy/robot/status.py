"""What a robot server says of itself on `/yumi/status`: the same type on both ends of the wire."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from skewmi.deploy.robot.states import ServerEvent, ServerState
from skewmi.deploy.wire.messages import (
    COMMANDER_REFUSED_STAMPS,
    ERROR,
    OK,
    WARN,
    Status,
    decode_status,
    encode_status,
    refused_stamps,
)
from skewmi.errors import TransportError

STATUS_NAME = "skewmi_robot"
"""Name of the robot server's entry in the status messages."""

DELAY_KEY = "delay_ms"
"""In `RobotStatus.told`, of a robot that has measured it: from a command to the joint state that
shows it, ms."""

_NO_STAMP = "None"
_COMMON = frozenset(
    {
        *("state", "reason", "accepted", "refused", "refusal", "refused_stamps_ns"),
        *("out_of_step", "refused_of_commander", "commander", "slips", "from", "event"),
        *("broken_of_commander", "last_refusal", "dropped", COMMANDER_REFUSED_STAMPS),
        *("workspace", "cycles_untold"),
    }
)
"""Keys that every robot server tells."""


@dataclass(frozen=True)
class RobotStatus:
    """State of a robot server, why it is in it, and what it has done with commands.

    The keys on the wire are the names of the fields, but for `source`, which is "from".
    """

    stamp_ns: int
    """The robot server's clock."""
    state: ServerState
    reason: str
    """Why it is in that state."""
    accepted: int = 0
    """Chunks, since it started."""
    refused: int = 0
    """Commands, since it started."""
    refusal: str = ""
    """Reasons of those refused since the last status, the commander's first."""
    refused_stamps_ns: tuple[int | None, ...] = ()
    """Of the chunks among them."""
    commander_refused_stamps_ns: tuple[int, ...] = ()
    """Those of them that are of the commander's chunks: of what it has sent, these are not
    executed."""
    out_of_step: bool = True
    """Whether the commander's refused ones came too late or after a lost one, and were fine
    otherwise."""
    refused_of_commander: int = 0
    """Commands of the present commander, since it armed."""
    broken_of_commander: int = 0
    """Of these, the ones that were wrong, and not just too late or after a lost one."""
    last_refusal: str = ""
    """Reason of the newest of these, or of those if there is none: a status that was lost may have
    had it."""
    commander: bytes = b""
    """Global id of the commander's publisher of chunks; empty without one."""
    slips: int = 0
    """How often cycles were left out because the server came too late."""
    told: Mapping[str, str] = field(default_factory=dict)
    """What this kind of robot says beyond that."""
    dropped: int = 0
    """Commands that were not looked at, since it started: more came than there was time for, or
    they did not tell who sent them."""
    workspace: str = "task"
    """Name of the one that the commander was granted."""
    cycles_untold: int = 0
    """Cycles that `/yumi/right/controller_state` lacks for want of time, since it started."""
    source: ServerState | None = None
    """The state before, if a change of state is told."""
    event: ServerEvent | None = None
    """What changed it."""

    @property
    def message(self) -> str:
        """State and reason, for people."""
        return f"{self.state.value}: {self.reason}"

    def encode(self) -> bytes:
        """diagnostic_msgs/DiagnosticArray with one entry."""
        level = ERROR if self.state is ServerState.FAULT else WARN if self.refused else OK
        values = {
            "state": self.state.value,
            "reason": self.reason,
            "accepted": str(self.accepted),
            "refused": str(self.refused),
            "refusal": self.refusal,
            "refused_stamps_ns": " ".join(map(str, self.refused_stamps_ns)),
            "out_of_step": str(self.out_of_step),
            "refused_of_commander": str(self.refused_of_commander),
            "commander": self.commander.hex(),
            "slips": str(self.slips),
            "broken_of_commander": str(self.broken_of_commander),
            "last_refusal": self.last_refusal,
            "dropped": str(self.dropped),
            "workspace": self.workspace,
            "cycles_untold": str(self.cycles_untold),
            COMMANDER_REFUSED_STAMPS: " ".join(map(str, self.commander_refused_stamps_ns)),
        }
        values = {**self.told, **values}
        if self.source is not None and self.event is not None:
            values |= {"from": self.source.value, "event": self.event.value}
        return encode_status(Status(self.stamp_ns, STATUS_NAME, level, self.message, values))

    @staticmethod
    def decode(payload: bytes) -> RobotStatus | None:
        """Inverse of `encode`; None if the message tells of somebody else.

        Raises:
            TransportError: Not a status, or not of a robot server of this version.
        """
        status = decode_status(payload)
        if status.name != STATUS_NAME:
            return None
        values = status.values
        try:
            stamps = values["refused_stamps_ns"].split()
            return RobotStatus(
                stamp_ns=status.stamp_ns,
                state=ServerState(values["state"]),
                reason=values["reason"],
                accepted=int(values["accepted"]),
                refused=int(values["refused"]),
                refusal=values["refusal"],
                refused_stamps_ns=tuple(None if s == _NO_STAMP else int(s) for s in stamps),
                out_of_step=values["out_of_step"] == str(True),
                refused_of_commander=int(values["refused_of_commander"]),
                commander=bytes.fromhex(values["commander"]),
                slips=int(values["slips"]),
                told={key: text for key, text in values.items() if key not in _COMMON},
                broken_of_commander=int(values.get("broken_of_commander", 0)),
                last_refusal=values.get("last_refusal", ""),
                dropped=int(values.get("dropped", 0)),
                workspace=values.get("workspace", "task"),
                cycles_untold=int(values.get("cycles_untold", 0)),
                commander_refused_stamps_ns=refused_stamps(status),
                source=ServerState(values["from"]) if "from" in values else None,
                event=ServerEvent(values["event"]) if "event" in values else None,
            )
        except (KeyError, ValueError) as error:
            raise TransportError(
                f"the robot server's status cannot be read ({error}); "
                "is it of another version of skewmi?"
            ) from error
