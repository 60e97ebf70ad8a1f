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
