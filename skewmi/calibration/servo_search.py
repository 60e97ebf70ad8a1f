"""The search for the servos, all over their range and at every delay.

All joints share the delay, and a joint can make up for a wrong one: what is added to the delay is
taken from kd / kp, and with another stiffness the next order fits, too. Each joint that has done so
holds the delay where it is, in a minimum of its own; neither the joint nor the delay leaves it
alone. So the delay is not searched with the joints but before them: at each of several delays
every joint is fitted by itself, from several starts, and the delay that suits them all is where the
search begins. From what is found it looks around in the same manner: at delays beside it, and for
each joint from elsewhere, whatever its residual looks like.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skewmi.calibration.servo_fit import ServoFit, hangs_together
from skewmi.calibration.servo_model import ServoModel
from skewmi.calibration.servo_parameters import ServoUnknowns
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.servo_rivals import (
    BETTER,
    likely,
    log_squares,
    losses,
    outside,
    with_its_delay,
)
from skewmi.calibration.servo_starts import (
    SUCH_DELAYS_S,
    best_joints,
    later,
    start_grid,
    starts_around,
)
from skewmi.robot_models.yumi import Array
from skewmi.trajectory import GRID_S

START_S, LOOK_S = 6.0, 12.0
"""Of a recording that starts, and minima, are compared by, s."""
DELAYS_BESIDE_S = (-0.0015, 0.0015, -0.005, 0.005)
"""More delay than a minimum has, at which it is looked for better ones, s."""
FIRST_ITERATIONS, FURTHER_ITERATIONS, ITERATIONS = 3, 4, 15
LOOKS = 3
LEAST_MOTION = 1e-3
"""Of a joint that has moved, rad."""


@dataclass(frozen=True, eq=False)
class SearchedServos:
    """What a search has found.

    Attributes:
        vector: The best. Shape (p,).
        rivals: Others that suit what was looked at hardly less: those far from it, and all if the
            model lacks something. Shape (p, k).
    """

    vector: Array
    rivals: Array


class ServoSearch:
    """Looks for the servos of a recording.

    Args:
        model: That candidates are simulated with.
        recordings: The first of them is searched, or a part of it.
        unknowns: What vectors mean.
    """

    def __init__(
        self, model: ServoModel, recordings: Sequence[ServoRecording], unknowns: ServoUnknowns
    ) -> None:
        seconds = sum(float(np.ptp(recording.times_s)) for recording in recordings)
        # Most of the way on a part of the motion, at a part of the time.
        parts = (beginning(recordings[0], LOOK_S),) if seconds > 2.0 * LOOK_S else recordings
        self._first = ServoFit(model, (beginning(recordings[0], START_S),), unknowns)
        self._fit = ServoFit(model, parts, unknowns)
        self._unknowns = unknowns

    def run(self, start: Array | None) -> SearchedServos:
        """Search.

        Args:
            start: Where to begin; without it all over the range. Shape (p,).
        """
        fit = self._fit
        vector = self._start() if start is None else start
        vector = fit.descended(vector, ITERATIONS)
        for _ in range(LOOKS):
            looked, residual = vector, fit.residual(vector[:, None])[..., 0]
            vectors, squares = self._around(looked)
            loss = losses(squares, residual)
            best = loss.sum(axis=0).argmin()
            if loss[:, best].sum() > -BETTER:
                break
            vector = fit.descended(vectors[:, best], ITERATIONS)
        rivals = likely(looked, vectors, loss)
        # Of a model that lacks something minima are many, and next to one another.
        if not hangs_together(residual):
            rivals = rivals[:, outside(rivals, looked, fit.covariance(looked, residual))]
        return SearchedServos(vector, with_its_delay(rivals, looked, vector))

    def _start(self) -> Array:
        """The delay at which the joints fit best, each from its best start at that delay."""
        vectors, kinds, delays = together(
            [start_grid(self._unknowns, delay) for delay in SUCH_DELAYS_S]
        )
        vectors, _ = best_joints(vectors, self._first.squares(vectors), kinds)
        vectors, squares = self._first.joints_fitted(vectors, FIRST_ITERATIONS)
        vectors, _ = best_joints(vectors, squares, delays)
        vectors, squares = self._first.joints_fitted(vectors, FURTHER_ITERATIONS)
        best: Array = vectors[:, log_squares(squares).sum(axis=0).argmin()]
        return best

    def _around(self, vector: Array) -> tuple[Array, Array]:
        """The best at each delay and all kinds at the vector's own, with their joints' squares.

        Shapes (p, k) and (7, k).
        """
        unknowns, fit = self._unknowns, self._fit
        vectors, kinds, delays = together(
            [
                starts_around(unknowns, vector, grid=True),
                *(
                    starts_around(unknowns, later(unknowns, vector, delay), grid=False)
                    for delay in DELAYS_BESIDE_S
                ),
            ]
        )
        vectors, _ = best_joints(vectors, fit.squares(vectors), kinds)
        vectors, squares = fit.joints_fitted(vectors, FIRST_ITERATIONS)
        best, _ = best_joints(vectors, squares, delays)
        return fit.joints_fitted(np.column_stack((best, vectors[:, delays[0]])), FURTHER_ITERATIONS)


def beginning(recording: ServoRecording, seconds: float) -> ServoRecording:
    """The part of a recording in which all joints have moved for some time."""
    q = recording.commands.q
    moved = (np.abs(q - q[0]) > LEAST_MOTION).argmax(axis=0)
    return recording.shortened(GRID_S * float(moved.max()) + seconds)


def together(
    parts: Sequence[tuple[Array, list[range]]],
) -> tuple[Array, list[range], list[range]]:
    """Sets of vectors beside one another.

    Args:
        parts: Vectors, shape (p, k), and the columns of each kind.

    Returns:
        Vectors, shape (p, k); the columns of each kind in them; and, of each part, which kinds.
    """
    kinds: list[range] = []
    members: list[range] = []
    columns = 0
    for vectors, own in parts:
        members.append(range(len(kinds), len(kinds) + len(own)))
        kinds += [range(columns + kind.start, columns + kind.stop) for kind in own]
        columns += vectors.shape[1]
    return np.concatenate([vectors for vectors, _ in parts], axis=1), kinds, members
