"""Commands that were not followed, and how they are told."""

from __future__ import annotations

from typing import NamedTuple

NOTED_REFUSALS = 32
"""Reasons of others than the commander that are kept for the next status; all are counted."""

NOTED_OF_COMMANDER = 256
"""The same for the commander's, which come first."""

_LONGEST_REASON = 300
"""Characters; reasons hold what strangers have sent."""

_NO_WORDS = "for a reason that cannot be printed"


def printable(text: str) -> str:
    """A line of text from anywhere, fit to be told and kept: no control characters, not long."""
    line = "".join(c for c in text[:_LONGEST_REASON] if c.isprintable())
    return line + (" ..." if len(text) > _LONGEST_REASON else "")


class Refusal(NamedTuple):
    """A command that was not followed."""

    reason: str
    out_of_step: bool = False
    """Whether it came too late or after a lost one, and was otherwise fine."""
    stamp_ns: int | None = None
    """Of the refused chunk, if it was one."""
    of_commander: bool = False
    """Whether the one who holds the arm sent it."""


class Refusals:
    """What has been refused: counted for good, its reasons kept until they are told."""

    def __init__(self) -> None:
        self.count = 0
        """Since the server started."""
        self.of_commander = 0
        """Of those, the present commander's, since it armed."""
        self.broken_of_commander = 0
        """Of these, the ones that were not just out of step."""
        self.last_of_commander = ""
        """Reason of the newest of these; of one that was not just out of step, if there is one."""
        self.commander_untold = False
        """Whether one of the commander's has not been told yet."""
        self._untold: list[Refusal] = []

    def begin(self) -> None:
        """A commander has armed: what was refused before is none of its business."""
        self.of_commander = self.broken_of_commander = 0
        self.last_of_commander = ""

    def note(self, refusal: Refusal) -> None:
        """Count a refusal."""
        self.count += 1
        kept = NOTED_OF_COMMANDER if refusal.of_commander else NOTED_REFUSALS
        if refusal.of_commander or len(self._untold) < kept:
            refusal = refusal._replace(reason=printable(refusal.reason) or _NO_WORDS)
        if refusal.of_commander:
            self.of_commander += 1
            self.commander_untold = True
            if not refusal.out_of_step or not self.broken_of_commander:
                self.last_of_commander = refusal.reason
            self.broken_of_commander += not refusal.out_of_step
        if len(self._untold) < kept:
            self._untold.append(refusal)

    def take(self) -> list[Refusal]:
        """What has been refused since the last call."""
        taken, self._untold, self.commander_untold = self._untold, [], False
        return taken
