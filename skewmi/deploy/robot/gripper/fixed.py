"""Fingers that were set by hand, or a tool in their place: they stay as they are."""

from __future__ import annotations

from skewmi.deploy.robot.gripper.base import check_opening
from skewmi.errors import CommandRefusedError, ConfigurationError

TOLERANCE = 0.5e-3
"""m: what counts as the same opening."""


class FixedGripper:
    """Fingers at one opening; satisfies `Gripper`.

    Args:
        opening: Travel of each finger from closed, m.

    Raises:
        ConfigurationError: Fingers cannot be so far open.
    """

    def __init__(self, opening: float) -> None:
        try:
            check_opening(opening)
        except CommandRefusedError as error:
            raise ConfigurationError(f"fixed gripper: {error}") from None
        self.opening = opening

    def problem(self) -> str | None:
        """Nothing can go wrong."""
        return None

    def open_to(self, opening: float) -> None:
        """Accept the opening that the fingers have.

        Raises:
            CommandRefusedError: Another one.
        """
        check_opening(opening)
        if abs(opening - self.opening) > TOLERANCE:
            raise CommandRefusedError(
                f"the fingers are fixed {1e3 * self.opening:g} mm open and cannot move to "
                f"{1e3 * opening:g} mm; a policy that moves them needs another --gripper"
            )

    def forget(self) -> None:
        """Nothing is ever told."""

    def close(self) -> None:
        """Nothing is left."""
