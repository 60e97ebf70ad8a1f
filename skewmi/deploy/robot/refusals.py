"""Commands that were not followed, and how they are told."""

from __future__ import annotations

from typing import NamedTuple

NOTED_REFUSALS = 32
"""Reasons of others than the commander that are kept for the next status; all are counted."""

_LONGEST_REASON = 300
"""Characters; reasons hold what strangers have sent."""


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
        self._untold: list[Refusal] = []

    def note(self, refusal: Refusal) -> None:
        """Count a refusal."""
        self.count += 1
        self.of_commander += refusal.of_commander
        if refusal.of_commander or len(self._untold) < NOTED_REFUSALS:
            self._untold.append(refusal._replace(reason=printable(refusal.reason)))

    def take(self) -> list[Refusal]:
        """What has been refused since the last call."""
        taken, self._untold = self._untold, []
        return taken
