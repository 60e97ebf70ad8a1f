"""Stiffness, damping, friction and delay of the servos from commanded and measured positions.

The arm is simulated under the recorded commands (`ServoModel`), and what is unknown is chosen such
that simulated positions are the measured ones, by least squares. Candidates are simulated in
batches; the optimiser is `mujoco.minimize.least_squares`, the one of `mujoco.sysid`. The rest of
that toolbox is not used: it compiles a model for every candidate, and its intervals take residuals
for white (`uncertainty` says why they are not). So nothing beyond mujoco itself is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from mujoco import minimize
from numpy.typing import NDArray

from skewmi.calibration.servo_estimates import Estimate, estimates
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_parameters import ServoUnknowns
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.servo_starts import first_start, other_starts
from skewmi.calibration.uncertainty import autocorrelation_time, fit_covariance
from skewmi.errors import ConfigurationError
from skewmi.robot_models.servo import ServoParameters
from skewmi.robot_models.yumi import Array

SETTLE_S = 0.5
"""Left out after the motion begins, s: friction holds a resting joint anywhere around its command,
and it takes a movement until the simulated joint is where the real one is."""
RESOLUTION = 1e-5
"""Least standard deviation of a residual, rad: no encoder and no integrator is better."""
TRIES = 5
STUCK_MEMORY = 1.6
"""Autocorrelation time of a joint's residual, in samples, from which it may be stuck."""
BETTER = 0.98
"""Of a joint's squared residual, to be taken for better."""
LOOK_S = 12.0
"""Of a recording that a start is judged by, s."""
STEP = 1e-4
XTOL = 1e-4
"""Of the parameters, relative: a tenth of what the best recordings tell."""
ITERATIONS, ITERATIONS_AGAIN = 40, 8
NOT_EQUAL = 1.5
"""Ratio of the joints' residuals from which the fit is repeated with weights for it."""
HANG_TOGETHER_S = 1.0


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
        self._model, self._recordings = model, tuple(recordings)
        self._unknowns = ServoUnknowns(nominal, free_armature)
        self._inertia = inertia_uncertainty
        self._rows = [r.times_s >= r.motion_begins_s + SETTLE_S for r in recordings]

    def run(self, start: DelayedServo | None = None) -> ServoIdentification:
        """Identify.

        Args:
            start: Where to begin, of an earlier calibration; without it several are tried.
        """
        nominal = self._unknowns.nominal
        seconds = sum(float(np.ptp(r.times_s)) for r in self._recordings)
        vector = self._start() if start is None else self._unknowns.vector(start)
        weight = np.full(7, 1.0 / RESOLUTION)
        if seconds > 2.0 * LOOK_S:
            # Most of the way on a part of the motion, at a part of the time.
            part = ServoIdentifier(
                self._model,
                (first_seconds(self._recordings[0]),),
                nominal,
                free_armature=self._unknowns.free_armature,
            )
            vector = part._settled(vector, weight)
            vector = self._minimised(vector, weight, ITERATIONS)
        else:
            vector = self._settled(vector, weight)
        residual = self._residual(vector[:, None])[..., 0]
        sigma = self._sigma(residual)
        if sigma.max() > NOT_EQUAL * sigma.min():
            weight = 1.0 / sigma
            vector = self._minimised(vector, weight, ITERATIONS_AGAIN)
            residual = self._residual(vector[:, None])[..., 0]
            sigma = self._sigma(residual)
        lags = round(HANG_TOGETHER_S * len(residual) / seconds)
        covariance = fit_covariance(residual, self._jacobian(vector), weight, sigma, lags)
        far = self._residual(self._unknowns.vector(DelayedServo(nominal, 0.0))[:, None])
        return ServoIdentification(
            servo=self._unknowns.servo(vector),
            estimates=estimates(self._unknowns, vector, covariance, self._inertia),
            residual_rms=joint_rms(residual),
            autocorrelation_time=np.array([autocorrelation_time(c) for c in residual.T]),
            nominal_rms=float(np.sqrt((far**2).mean())),
            seconds_of_motion=seconds,
        )

    def _start(self) -> Array:
        return first_start(self._model, self._unknowns, first_seconds(self._recordings[0]))

    def _settled(self, vector: Array, weight: Array) -> Array:
        """The minimum, sought again from elsewhere for joints whose residual is not noise.

        The valleys of stiffness, damping and friction are long and bent: a joint can be stuck far
        off, where its ratios to the stiffness are nearly right.
        """
        vector = self._minimised(vector, weight, ITERATIONS)
        for rank in range(TRIES):
            residual = self._residual(vector[:, None])[..., 0]
            memory = np.array([autocorrelation_time(column) for column in residual.T])
            stuck = np.flatnonzero(memory > STUCK_MEMORY)
            if not stuck.size:
                break
            others = other_starts(self._unknowns, vector)
            order = (self._residual(others) ** 2).sum(axis=0).argsort(axis=1)
            tried = vector
            for joint in stuck:
                tried = self._with_joints(
                    tried, others[:, order[joint, rank]], stuck[stuck == joint]
                )
            tried = self._minimised(tried, weight, ITERATIONS)
            found = self._residual(tried[:, None])[..., 0]
            better = (found**2).sum(axis=0) < BETTER * (residual**2).sum(axis=0)
            if better.any():
                vector = self._with_joints(vector, tried, np.flatnonzero(better))
                vector[-1] = tried[-1]
                vector = self._minimised(vector, weight, ITERATIONS)
        return vector

    def _with_joints(self, vector: Array, other: Array, joints: NDArray[np.int64]) -> Array:
        """A vector with some joints' numbers of another one."""
        rows = (7 * np.arange(self._unknowns.size // 7)[:, None] + joints).ravel()
        mixed: Array = vector.copy()
        mixed[rows] = other[rows]
        return mixed

    def _residual(self, vectors: Array) -> Array:
        """Simulated less measured positions, rad. (p, k) -> (m, 7, k)."""
        servos = [self._unknowns.servo(column) for column in vectors.T]
        parts = [
            (self._model.positions(servos, recording) - recording.positions)[:, rows]
            for recording, rows in zip(self._recordings, self._rows, strict=True)
        ]
        residual: Array = np.concatenate(parts, axis=1).transpose(1, 2, 0)
        return residual

    def _minimised(self, vector: Array, weight: Array, iterations: int) -> Array:
        found, _ = minimize.least_squares(
            vector,
            weighted_columns(self._residual, weight),
            bounds=self._unknowns.bounds(),
            eps=STEP,
            max_iter=iterations,
            xtol=XTOL,
            verbose=minimize.Verbosity.SILENT,
            x_scale="jac",
        )
        best: Array = found.ravel()
        return best

    def _jacobian(self, vector: Array) -> Array:
        """By central differences where the bounds leave room, rad. Shape (m, 7, p)."""
        low, high = self._unknowns.bounds()
        step = np.diag(STEP * np.maximum(1.0, np.abs(vector)))
        ahead = np.clip(vector[:, None] + step, low[:, None], high[:, None])
        behind = np.clip(vector[:, None] - step, low[:, None], high[:, None])
        width = np.diag(ahead) - np.diag(behind)
        return (self._residual(ahead) - self._residual(behind)) / width

    def _sigma(self, residual: Array) -> Array:
        free = max(len(residual) - self._unknowns.size / 7.0, 1.0)
        sigma: Array = np.maximum(np.sqrt((residual**2).sum(axis=0) / free), RESOLUTION)
        return sigma


def position_rms(model: ServoModel, servo: DelayedServo, recording: ServoRecording) -> Array:
    """RMS of simulated less measured positions of a recording, rad. Shape (7,)."""
    rows = recording.times_s >= recording.motion_begins_s + SETTLE_S
    return joint_rms((model.positions([servo], recording)[0] - recording.positions)[rows])


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


def weighted_columns(residual: Callable[[Array], Array], weight: Array) -> Callable[[Array], Array]:
    """As the optimiser wants it: (p, k) -> (7 m, k)."""

    def weighted(vectors: Array) -> Array:
        found = residual(vectors) * weight[:, None]
        return found.reshape(-1, found.shape[-1])

    return weighted


def first_seconds(recording: ServoRecording) -> ServoRecording:
    """The part of a motion that a start is judged by."""
    return recording.shortened(recording.motion_begins_s + LOOK_S)


def joint_rms(residual: Array) -> Array:
    """Root mean square over all samples. (m, 7) -> (7,)."""
    rms: Array = np.sqrt((residual**2).mean(axis=0))
    return rms


def require_motion(recording: ServoRecording) -> None:
    """See that all joints move, long enough.

    Raises:
        ConfigurationError: They do not.
    """
    still = np.flatnonzero(np.ptp(recording.commands.q, axis=0) < 1e-3)
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
