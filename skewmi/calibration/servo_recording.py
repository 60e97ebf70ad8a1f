"""What servo identification starts from: what was commanded, and what was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skewmi.errors import ConfigurationError
from skewmi.robot_models.yumi import Array
from skewmi.trajectory import GRID_S, JointTrajectory

SHORTEST_S = 2.0
"""Of a motion from which anything can be identified, s."""
_ENOUGH_STILL = 10
"""Measurements at rest that tell how much they scatter."""


@dataclass(frozen=True, eq=False)
class ServoRecording:
    """One motion of the right arm in free space.

    Attributes:
        commands: The reference that was carried out, tick by tick: sample k is the servos' target
            from k * 4 ms on, if nothing is delayed. It begins at rest.
        times_s: When positions were measured, on the clock of the commands, rising, s. Shape (m,).
        positions: Measured joint positions, chain order, rad. Shape (m, 7).
        efforts: What the servos pushed with at these times, N m, gravity not in it. Shape (m, 7);
            None if the robot does not tell.

    Raises:
        ConfigurationError: Shapes or numbers are not as above, or it is too short.
    """

    commands: JointTrajectory
    times_s: Array
    positions: Array
    efforts: Array | None = None

    def __post_init__(self) -> None:
        times = np.array(self.times_s, dtype=np.float64)
        positions = np.array(self.positions, dtype=np.float64)
        if self.commands.q.shape[1:] != (7,) or positions.shape != (len(times), 7):
            raise ConfigurationError(
                f"a servo recording has commands {self.commands.q.shape}, times {times.shape} and "
                f"positions {positions.shape}; they must be (n, 7), (m,) and (m, 7)"
            )
        efforts = None if self.efforts is None else np.array(self.efforts, dtype=np.float64)
        if efforts is not None and efforts.shape != positions.shape:
            raise ConfigurationError(
                f"a servo recording has efforts {efforts.shape}; they must be as the positions, "
                f"{positions.shape}"
            )
        parts = [self.commands.q, self.commands.v, times, positions]
        parts += [] if efforts is None else [efforts]
        if not all(np.isfinite(part).all() for part in parts):
            raise ConfigurationError("a servo recording has numbers that are not finite")
        if (np.diff(times) <= 0.0).any():
            raise ConfigurationError("the times of a servo recording must rise")
        inside = (times >= 0.0) & (times <= self.commands.duration_s)
        kept = times[inside]
        if not kept.size or kept[-1] - kept[0] < SHORTEST_S:
            raise ConfigurationError(
                f"a servo recording must have measurements over {SHORTEST_S:g} s of its commands' "
                f"{self.commands.duration_s:g} s at least"
            )
        if np.abs(self.commands.v[0]).max() > 1e-6:
            raise ConfigurationError("the commands of a servo recording must begin at rest")
        object.__setattr__(self, "times_s", kept)
        object.__setattr__(self, "positions", positions[inside])
        if efforts is not None:
            object.__setattr__(self, "efforts", efforts[inside])

    @property
    def motion_begins_s(self) -> float:
        """When the commands first differ from where they began, s; their end if they never do."""
        moves = np.flatnonzero(np.abs(self.commands.q - self.commands.q[0]).max(axis=1) > 1e-9)
        index = int(moves[0]) if moves.size else len(self.commands) - 1
        return index * GRID_S

    @property
    def start(self) -> Array:
        """Where the arm rested before it moved, rad: the mean of what was measured then.

        Shape (7,).
        """
        still = self.times_s <= max(self.motion_begins_s, self.times_s[0])
        mean: Array = self.positions[still].mean(axis=0)
        return mean

    @property
    def rest_noise(self) -> float:
        """Standard deviation of a joint angle while the arm rests before it moves, rad; of the
        joint with the median one. 0 if there are less than ten measurements."""
        still = self.positions[self.times_s <= self.motion_begins_s]
        return float(np.median(still.std(axis=0))) if len(still) >= _ENOUGH_STILL else 0.0

    def shortened(self, seconds: float) -> ServoRecording:
        """The first part of it."""
        rows = slice(0, round(max(seconds, SHORTEST_S) / GRID_S) + 1)
        return ServoRecording(self.commands.part(rows), self.times_s, self.positions, self.efforts)
