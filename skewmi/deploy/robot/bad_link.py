"""A link that loses messages and delivers others late, for simulated robots that ask for one."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from skewmi.deploy.robot.backend import LinkErrors

_STREAM = 2
"""Keeps these random numbers apart from a variation's values and sensor errors."""

Send = Callable[[bytes], None]


class BadLink:
    """Holds messages back, in the order in which they came: a stream does not overtake itself.

    What is due is sent by the next `carry`, so that a message is late by up to a cycle more.

    Args:
        errors: How bad it is. Equal ones lose the same messages and draw the same delays.
    """

    def __init__(self, errors: LinkErrors) -> None:
        self.errors = errors
        self._rng = np.random.default_rng([*errors.seed, _STREAM])
        self._held: deque[tuple[int, Send, bytes]] = deque()
        self._last_due_ns = 0

    def take(self, send: Send, payload: bytes, now_ns: int) -> None:
        """Lose a message, or send it when it is due.

        Args:
            send: Puts it on the real link.
            payload: The message.
            now_ns: Present time of a clock that does not jump.
        """
        lost, late = self._rng.random(2).tolist()
        if lost < self.errors.loss:
            return
        delay_s = self.errors.delay_s + late * self.errors.jitter_s
        self._last_due_ns = max(self._last_due_ns, now_ns + round(1e9 * delay_s))
        self._held.append((self._last_due_ns, send, payload))
        self.carry(now_ns)

    def carry(self, now_ns: int) -> None:
        """Send what is due."""
        while self._held and self._held[0][0] <= now_ns:
            _, send, payload = self._held.popleft()
            send(payload)
