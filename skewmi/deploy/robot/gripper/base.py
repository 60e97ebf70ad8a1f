"""What a gripper is to a robot: an opening that can be asked for, and one that is measured."""

from __future__ import annotations

from typing import Protocol

from skewmi.errors import CommandRefusedError
from skewmi.robot_models import yumi


class Gripper(Protocol):
    """A gripper whose fingers move alike. Used by the robot server's loop alone; nothing waits."""

    @property
    def opening(self) -> float:
        """Measured travel of each finger from closed, m; the last known one if it is silent."""

    def problem(self) -> str | None:
        """What keeps it from doing what it is told, in words; None if nothing does."""

    def open_to(self, opening: float) -> None:
        """Move each finger to `opening` m from closed, as soon as possible.

        Raises:
            CommandRefusedError: Not an opening, or not now; the message says why.
        """

    def forget(self) -> None:
        """Whoever asked for an opening commands the arm no longer: what the gripper has not been
        told yet is not told it any more."""

    def close(self) -> None:
        """End; the fingers stay where they are."""


def check_opening(opening: float) -> None:
    """Whether fingers can be so far open.

    Raises:
        CommandRefusedError: They cannot.
    """
    if not 0.0 <= opening <= yumi.GRIPPER.travel:
        raise CommandRefusedError(
            f"finger opening {opening:.4g} m is outside 0..{yumi.GRIPPER.travel:g} m"
        )
