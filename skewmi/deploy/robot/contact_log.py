"""Contact forces of the last cycles, kept until a status tells them."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from skewmi.deploy.robot.backend import RobotBackend, TellsContact
from skewmi.deploy.wire.simulation_status import CONTACT_FORCES, ContactForces, encode_forces

_MOST = 1000
"""Cycles between two statuses: 20 s of robot time, which half a second of a robot in lock-step may
have; of more, the newest are told."""


class ContactLog:
    """What a robot felt in each published cycle; empty of one that does not tell.

    Args:
        backend: The robot.
    """

    def __init__(self, backend: RobotBackend) -> None:
        self._backend = backend if isinstance(backend, TellsContact) else None
        self._felt: deque[tuple[int, float, float]] = deque(maxlen=_MOST)
        self._stamp_ns: int | None = None

    def note(self, stamp_ns: int) -> None:
        """A cycle is published. A state that is told again has nothing new."""
        if self._backend is not None and stamp_ns != self._stamp_ns:
            self._stamp_ns = stamp_ns
            self._felt.append((stamp_ns, *self._backend.contact_forces()))

    def take(self) -> Mapping[str, str]:
        """For the status: what was felt since the last call; nothing if there was no cycle."""
        if not self._felt:
            return {}
        stamps_ns, hand, arm = zip(*self._felt, strict=True)
        self._felt.clear()
        forces = ContactForces(np.array(stamps_ns), np.array(hand), np.array(arm))
        return {CONTACT_FORCES: encode_forces(forces)}
