"""What statuses tell beyond states: contact forces, where the scene stands, and counts."""

from __future__ import annotations

import numpy as np

from skewmi.deploy.replay.buffers import NS_PER_S
from skewmi.deploy.replay.data import Placement, Series
from skewmi.deploy.wire.messages import Status
from skewmi.deploy.wire.simulation_status import (
    ContactForces,
    ScenePose,
    decode_forces,
    decode_poses,
)
from skewmi.errors import TransportError

FORCES = ("hand", "arm without hand")
COUNTS = {
    "refused_of_commander": "commands refused",
    "slips": "robot came too late",
    "cycles_untold": "cycles not published",
    "dropped": "commands not looked at",
}
"""What the robot server counts, by key of its status."""


class ToldBuffer:
    """Takes statuses in, and hands out what has come since the last look."""

    def __init__(self) -> None:
        self._forces: list[ContactForces] = []
        self._newest_ns: int | None = None
        self._poses: list[tuple[int, tuple[ScenePose, ...]]] = []
        self._pose: tuple[ScenePose, ...] | None = None
        self._counts: list[tuple[int, tuple[float, ...]]] = []

    def add(self, status: Status) -> None:
        """Take in a status of anybody.

        Raises:
            TransportError: A value cannot be read.
        """
        poses, forces = decode_poses(status.values), decode_forces(status.values)
        if poses is not None and poses != self._pose:
            self._pose = poses
            self._poses.append((status.stamp_ns, poses))
        if forces is not None and len(forces.stamps_ns):
            self._forces.append(forces)
        if "slips" in status.values:
            try:
                counts = tuple(float(int(status.values.get(key, "0"))) for key in COUNTS)
            except ValueError as error:
                raise TransportError(f"counts of a status cannot be read: {error}") from error
            self._counts.append((status.stamp_ns, counts))

    def take_forces(self, origin_ns: int) -> Series:
        """Largest forces of each cycle, N."""
        parts, self._forces = self._forces, []
        stamps_ns = np.concatenate([np.zeros(0, np.int64), *(part.stamps_ns for part in parts)])
        hand = np.concatenate([np.zeros(0), *(part.hand_n for part in parts)])
        arm = np.concatenate([np.zeros(0), *(part.arm_n for part in parts)])
        # Each cycle is told once; a status that came twice has nothing new.
        before = self._newest_ns if self._newest_ns is not None else np.iinfo(np.int64).min // 2
        new = np.diff(np.maximum.accumulate(np.append(before, stamps_ns))) > 0
        if new.any():
            self._newest_ns = int(stamps_ns[new][-1])
        times = (stamps_ns[new] - origin_ns) / NS_PER_S
        return Series(times, FORCES, np.column_stack([hand[new], arm[new]]))

    def take_poses(self, origin_ns: int) -> tuple[Placement, ...]:
        """Where the scene stands from when on; only changes."""
        poses, self._poses = self._poses, []
        return tuple(
            Placement(max(0.0, (stamp_ns - origin_ns) / NS_PER_S), there)
            for stamp_ns, there in poses
        )

    def take_counts(self, origin_ns: int) -> Series:
        """What the robot server has counted since it started."""
        rows, self._counts = self._counts, []
        times = np.array([max(0.0, (stamp_ns - origin_ns) / NS_PER_S) for stamp_ns, _ in rows])
        values = np.array([counts for _, counts in rows]).reshape(len(rows), len(COUNTS))
        return Series(times, tuple(COUNTS.values()), values)
