"""Commanded motion that is still to come when a hand is measured.

A deployed session plans, smooths and sends ahead: when a hand is measured, some 0.1 s of what it
was commanded is yet to happen. `CommandIntegrator` is told of it by these, in a session and in a
simulation that is as late as one. Numpy only.
"""

from __future__ import annotations

import numpy as np

from skewmi.policy_io import Array

FOLLOWING, NOT_FOLLOWING = 0.005, 0.010
"""Distances of measured from commanded hand up to which, and from which on, the arm counts as
following and as blocked, m; linear between."""

LONGEST_REACTION_S = 0.05
"""What is looked ahead by at most, s: with more, an arm that is late looks like a blocked one."""


def hand_ahead(hand_w: Array, commanded_w: Array, position_w: Array) -> Array:
    """Where measured hands will be once they have made the motion that is under way.

    That motion is added as long as the arm follows. An arm that is blocked does not: then the
    bound is on command against measured hand, as it should be.

    Args:
        hand_w: Measured, world, m. Shape (n, 3).
        commanded_w: Where they were commanded to be then. Shape (n, 3).
        position_w: Where the command ends. Shape (n, 3).

    Returns:
        World, m. Shape (n, 3).
    """
    deviation = np.linalg.norm(hand_w - commanded_w, axis=-1, keepdims=True)
    trust = np.clip((NOT_FOLLOWING - deviation) / (NOT_FOLLOWING - FOLLOWING), 0.0, 1.0)
    ahead_w: Array = hand_w + trust * (position_w - commanded_w)
    return ahead_w


class ErrorGrowth:
    """How fast the following error grows, from one look at the hands to the next.

    Args:
        n: Number of hands.
    """

    def __init__(self, n: int) -> None:
        self.begin(np.zeros((n, 3)), 0)

    def begin(self, error_w: Array, time_ns: int) -> None:
        """Look anew: what was before does not count.

        Args:
            error_w: Commanded less measured hand, world, m. Shape (n, 3).
            time_ns: When, on any clock.
        """
        self._error_w, self._time_ns = error_w, time_ns

    def coming(self, error_w: Array, time_ns: int, reaction_s: float) -> Array:
        """What the error grows by before a command that is ended now slows the hands down, if it
        goes on as since the last look.

        Args:
            error_w: As in `begin`, now.
            time_ns: When that is; without time since the last look nothing grows.
            reaction_s: How long it takes until the hands slow down, s.

        Returns:
            World, m. Shape (n, 3).
        """
        before_w, elapsed_s = self._error_w, 1e-9 * (time_ns - self._time_ns)
        self.begin(error_w, time_ns)
        if elapsed_s <= 0.0:
            return np.zeros_like(error_w)
        grown_w: Array = (error_w - before_w) * (reaction_s / elapsed_s)
        return grown_w
