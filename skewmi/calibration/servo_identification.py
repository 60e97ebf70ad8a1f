"""Stiffness, damping, friction and delay of the servos from commanded and measured positions.

The arm is simulated under the recorded commands (`ServoModel`), and what is unknown is chosen such
that simulated positions are the measured ones, by least squares. Candidates are simulated in
batches; the optimiser is `mujoco.minimize.least_squares`, the one of `mujoco.sysid`. The rest of
that toolbox is not used: it compiles a model for every candidate, and its intervals take residuals
for white (`uncertainty` says why they are not). So nothing beyond mujoco itself is needed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skewmi.calibration.servo_estimates import Estimate, estimates
from skewmi.calibration.servo_fit import (
    SETTLE_S,
    ServoFit,
    autocorrelation_times,
    hangs_together,
    joint_rms,
    settled,
)
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_parameters import ServoUnknowns
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.servo_rivals import BETTER, outside, remaining_rivals, with_its_delay
from skewmi.calibration.servo_search import LEAST_MOTION, SearchedServos, ServoSearch
from skewmi.calibration.servo_stiction import fit_stiction
from skewmi.calibration.uncertainty import FitCovariance
from skewmi.errors import ConfigurationError
from skewmi.robot_models.servo import ServoParameters
from skewmi.robot_models.yumi import Array

ITERATIONS, ITERATIONS_AGAIN = 12, 6
"""On all of the motion, before and after the joints are weighted anew."""
ITERATIONS_OTHERWISE = 3
"""The same with other weights and friction at rest, which takes three times as long."""
ROUNDS = 2
"""Times that what is found may give way to a better rival."""


@dataclass(frozen=True, eq=False)
class ServoIdentification:
    """What was found.

    Attributes:
        servo: The servos.
        estimates: `kp` (N m/rad), `kd` (N m s/rad), `frictionloss` (N m), `kd_over_kp` (s),
            `frictionloss_over_kp` (rad), `delay` (s), and `armature` (kg m^2) if it was unknown.
        residual_rms: Of simulated less measured positions, rad. Shape (7,).
        autocorrelation_time: Of the residuals, in samples; 1 is white. Shape (7,).
        nominal_rms: Residual of the nominal servos, rad.
        seconds_of_motion: That were used.
    """

    servo: DelayedServo
    estimates: Mapping[str, Estimate]
    residual_rms: Array
    autocorrelation_time: Array
    nominal_rms: float
    seconds_of_motion: float


class ServoIdentifier:
    """Identifies servos from one or more recordings of one arm.

    Args:
        model: That candidates are simulated with.
        recordings: In free space.
        nominal: Where the search begins; its force limits and armature are taken for known.
        free_armature: Whether to identify the armature, too. Stiffness, damping, friction and
            armature of a wrist joint, whose link weighs nothing, then show as ratios only: the
            intervals of the constants say so.
        inertia_uncertainty: Standard deviation of the inertia that a joint moves (links and
            rotor), as a part of it. Positions tell kp, kd and frictionloss per inertia: a model
            15 % too light finds all three 15 % too small, and their ratios right. The intervals
            of the three are widened by it; with 0 they hold for the model's inertia alone.

    Raises:
        ConfigurationError: There is no recording, an arm does not move in one, or the
            uncertainty is not within 0..1.
    """

    def __init__(
        self,
        model: ServoModel,
        recordings: Sequence[ServoRecording],
        nominal: ServoParameters,
        *,
        free_armature: bool = False,
        inertia_uncertainty: float = 0.0,
    ) -> None:
        if not 0.0 <= inertia_uncertainty <= 1.0:
            raise ConfigurationError(
                f"inertia_uncertainty is {inertia_uncertainty}; it must be within 0..1"
            )
        if not recordings:
            raise ConfigurationError("servos are identified from one recording at least; got none")
        for recording in recordings:
            require_motion(recording)
        self._unknowns = ServoUnknowns(nominal, free_armature)
        self._inertia = inertia_uncertainty
        self._model, self._recordings = model, tuple(recordings)
        self._fit = ServoFit(model, recordings, self._unknowns)
        self._search = ServoSearch(model, recordings, self._unknowns)
        self._seconds = sum(float(np.ptp(recording.times_s)) for recording in recordings)

    def run(self, start: DelayedServo | None = None) -> ServoIdentification:
        """Identify.

        Args:
            start: Where to begin, of an earlier calibration; without it all over the range.
        """
        unknowns = self._unknowns
        searched = self._search.run(None if start is None else unknowns.vector(start))
        vector, residual, covariance = self._fitted(searched)
        fit = self._fit
        if hangs_together(residual):
            sticking = fit_stiction(self._model, self._recordings, self._unknowns, vector, residual)
            if sticking is not None:
                fit, vector = sticking.fit, sticking.vector
                residual = fit.residual(vector[:, None])[..., 0]
                rivals = otherwise(fit, vector, residual, ITERATIONS_OTHERWISE)
                covariance = fit.covariance(vector, residual)
                covariance = replace(covariance, rivals=rivals - vector[:, None])
        far = unknowns.vector(DelayedServo(unknowns.nominal, 0.0))
        return ServoIdentification(
            servo=fit.unknowns.servo(vector),
            estimates=estimates(fit.unknowns, vector, covariance, self._inertia),
            residual_rms=joint_rms(residual),
            autocorrelation_time=autocorrelation_times(residual),
            nominal_rms=float(np.sqrt(self._fit.squares(far[:, None]).mean())),
            seconds_of_motion=self._seconds,
        )

    def _fitted(self, searched: SearchedServos) -> tuple[Array, Array, FitCovariance]:
        """What was searched, fitted to all of the motion: vector, residual, and how far it may be
        off, which is as far as any rival that the data do not tell from it."""
        vector = self._fit.descended(searched.vector, ITERATIONS)
        rivals = with_its_delay(searched.rivals, searched.vector, vector)
        for _ in range(ROUNDS):
            best = self._fit.descended(vector, ITERATIONS_AGAIN)
            rivals = with_its_delay(rivals, vector, best)
            vector, rivals, loss = best, *remaining_rivals(self._fit, best, rivals)
            if loss.min(initial=0.0) > -BETTER:
                break
            # What was the best is one of the rivals now.
            vector, rivals = rivals[:, loss.argmin()], np.column_stack((rivals, best))
        residual = self._fit.residual(vector[:, None])[..., 0]
        covariance = self._fit.covariance(vector, residual)
        rivals = np.column_stack(
            (
                rivals[:, outside(rivals, vector, covariance)],
                otherwise(self._fit, vector, residual, ITERATIONS_AGAIN),
            )
        )
        return vector, residual, replace(covariance, rivals=rivals - vector[:, None])


def otherwise(fit: ServoFit, vector: Array, residual: Array, iterations: int) -> Array:
    """The minimum with joints weighted by the size of their residuals alone. Shape (p, 0 or 1).

    If the model is right any weights find the same. How far apart two of them are is what it
    lacks, of which no residual tells: a wrong mass drags the delay of all joints along.

    Args:
        fit: Of the servos.
        vector: The minimum. Shape (p,).
        residual: There, rad. Shape (m, 7).
        iterations: At most.
    """
    if not hangs_together(residual):
        return np.empty((len(vector), 0))
    return fit.minimised(vector, 1.0 / fit.sigma(residual), iterations)[:, None]


def position_rms(model: ServoModel, servo: DelayedServo, recording: ServoRecording) -> Array:
    """RMS of simulated less measured positions of a recording about its mean, rad. Shape (7,)."""
    error = (model.positions([servo], recording)[0] - recording.positions)[settled(recording)]
    return joint_rms(error - error.mean(axis=0))


def identify_servos(
    model: ServoModel,
    recordings: Sequence[ServoRecording],
    nominal: ServoParameters,
    *,
    free_armature: bool = False,
    inertia_uncertainty: float = 0.0,
    start: DelayedServo | None = None,
) -> ServoIdentification:
    """`ServoIdentifier` in one call; arguments and errors as there and in its `run`."""
    identifier = ServoIdentifier(
        model,
        recordings,
        nominal,
        free_armature=free_armature,
        inertia_uncertainty=inertia_uncertainty,
    )
    return identifier.run(start)


def require_motion(recording: ServoRecording) -> None:
    """See that all joints move, long enough.

    Raises:
        ConfigurationError: They do not.
    """
    still = np.flatnonzero(np.ptp(recording.commands.q, axis=0) < LEAST_MOTION)
    if still.size:
        raise ConfigurationError(
            f"joints {(still + 1).tolist()} of the chain do not move in a recording: nothing can "
            "be said of their servos; excite all seven"
        )
    left = recording.times_s[-1] - recording.motion_begins_s - SETTLE_S
    if left < 1.0:
        raise ConfigurationError(
            f"{left:.1f} s of a recording are left after its motion has begun; 1 s is the least"
        )
