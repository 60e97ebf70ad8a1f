"""What a session makes of its commands that were refused."""

from __future__ import annotations

import numpy as np

from skewmi.deploy.robot.status import RobotStatus
from skewmi.deploy.safety.limits import SPLICE_TOLERANCE
from skewmi.deploy.session.timing import BUSY_ADVICE
from skewmi.errors import CommandRefusedError
from skewmi.policy_io import Array


class OutOfStepError(CommandRefusedError):
    """Session and robot server do not agree on where the arm's motion is; nothing else is wrong.

    A motion may be planned anew from where the arm comes to rest; see `ControlLoop.recover`.
    """


class LateChunkError(OutOfStepError):
    """The robot server refused a chunk for coming too late or after a lost one; the arm brakes."""


class ReferenceMovedError(OutOfStepError):
    """The arm is not held any more where a motion was planned from; nothing of it was sent."""


def check_reference(held: Array, q: Array) -> None:
    """See that an arm is held where a motion was planned from.

    Args:
        held: Where the robot server holds it, rad. Shape (7,).
        q: From where it was planned, rad. Shape (7,).

    Raises:
        ReferenceMovedError: These are not the same place.
    """
    off = float(np.abs(held - q).max()) if held.shape == q.shape else float("inf")
    if not off <= SPLICE_TOLERANCE[0]:
        raise ReferenceMovedError(
            f"the robot server holds the arm {off:.3g} rad from where the motion was planned "
            f"to begin; at most {SPLICE_TOLERANCE[0]:g} rad are allowed: does anybody else "
            "move it?"
        )


def given_up(what: str, attempts: int, last: OutOfStepError | None) -> CommandRefusedError:
    """The error of motions that were begun often enough.

    Args:
        what: Their name, such as "start motions".
        attempts: How many there were.
        last: What ended the last one; None if a chunk would have come too late.
    """
    if isinstance(last, ReferenceMovedError):
        return CommandRefusedError(f"{attempts} {what} were planned for nothing; the last: {last}")
    return CommandRefusedError(f"{attempts} {what} came too late; {BUSY_ADVICE}")


class RefusedCommands:
    """Counts what a robot server has refused of ours since we armed.

    What it refused of others, or before, is none of our business: else anybody could stop us with a
    chunk of his own. Statuses can be lost, so that counts decide, not what a single one tells.

    Args:
        gid: Of our publisher of chunks.
    """

    def __init__(self, gid: bytes) -> None:
        self._gid = gid
        self._refused = self._broken = 0

    def check(self, status: RobotStatus, *, late_is_final: bool) -> None:
        """See whether more was refused than when this was last asked.

        Args:
            status: Of the robot server.
            late_is_final: Treat a late chunk as any other refused one.

        Raises:
            LateChunkError: All of it was late, or came after a lost one.
            CommandRefusedError: Some was not.
        """
        if status.commander != self._gid:
            return
        more = status.refused_of_commander > self._refused
        broken = status.broken_of_commander > self._broken or not status.out_of_step
        self._refused, self._broken = status.refused_of_commander, status.broken_of_commander
        if more:
            known = status.last_refusal in status.refusal
            reason = status.refusal if known else status.last_refusal
            kind = CommandRefusedError if broken or late_is_final else LateChunkError
            raise kind(
                f"the robot server refused a command: {reason or 'its reason was lost on the way'}"
            )
