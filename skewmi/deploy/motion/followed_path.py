"""Where on the commanded path the hand is wanted now: at the command, or a little behind it.

The command does not stop at corners; the hand must nearly. So this point r waits at a corner for a
moment and then goes after the command along its path, faster, until it has caught up. It never is
off the path. When it is too far behind, it waits no longer.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

CATCH_UP = 0.3
"""By which part of its speed it is faster than the command when it is behind."""

Vector = Sequence[float]


class FollowedPath:
    """The path that the command has taken and the point that follows on it.

    Args:
        max_steps: How many grid steps it may be behind.
    """

    def __init__(self, max_steps: int) -> None:
        self._max_steps = max_steps
        self._ahead: deque[tuple[Vector, Vector]] = deque()
        self._last: tuple[Vector, Vector] | None = None
        self._share = 0.0
        self._wait = 0

    def clear(self) -> None:
        """Forget the path: go on from where the command is next."""
        self._ahead.clear()
        self._last = None
        self._wait = 0
        self._share = 0.0

    def advance(
        self, position_w: Vector, velocity_w: Vector, wait_steps: Callable[[Vector], int]
    ) -> tuple[Vector, Vector]:
        """One grid step.

        Args:
            position_w: Of the command now, m. Shape (3,).
            velocity_w: With which it has come there, m/s. Shape (3,).
            wait_steps: How long to wait before a velocity, from the present motion, in grid
                steps.

        Returns:
            Position and velocity of the point that follows, m and m/s.
        """
        if self._last is None:
            self._last = position_w, velocity_w
            return self._last
        self._ahead.append((position_w, velocity_w))
        if self._wait > 0:
            self._wait -= 1
            if self._wait > 0 and len(self._ahead) <= self._max_steps:
                return self._last[0], (0.0, 0.0, 0.0)
            self._wait = 0
            self._last = self._last[0], self._ahead[0][1]
        behind = len(self._ahead) > 1
        self._share += 1.0 + CATCH_UP if behind else 1.0
        while self._share >= 1.0 and self._ahead:
            following = self._ahead[0]
            if following[1] != self._last[1]:
                wait = wait_steps(following[1])
                if wait > 0 and len(self._ahead) <= self._max_steps:
                    self._wait, self._share = wait, 0.0
                    return self._last[0], (0.0, 0.0, 0.0)
            self._last = self._ahead.popleft()
            self._share -= 1.0
        if not self._ahead:
            self._share = 0.0
            return self._last
        (here, _), (there, velocity) = self._last, self._ahead[0]
        share = self._share
        position = [a + share * (b - a) for a, b in zip(here, there, strict=True)]
        return position, [(1.0 + CATCH_UP) * v for v in velocity]
