"""The law of a controller behind EGM, its lag, and the servos behind it, from what was asked for
and measured positions.

As `servo_identification`, with the law before the servos: the arm is simulated under the recorded
references, and what is unknown is chosen such that simulated positions are the measured ones. Law
and lag are the same for all joints, servos are not: seven joints of different servos are what tells
the law from them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from skewmi.calibration.egm_estimates import egm_estimates
from skewmi.calibration.egm_law import EgmLaw, desired_motions
from skewmi.calibration.egm_model import SAME_PERIOD, EgmArm, EgmModel, EgmRecording
from skewmi.calibration.egm_parameters import EgmUnknowns
from skewmi.calibration.servo_estimates import Estimate
from skewmi.calibration.servo_fit import (
    HANG_TOGETHER_S,
    RESOLUTION,
    STEP,
    joint_rms,
    joint_sigma,
    minimised,
    settled,
)
from skewmi.calibration.servo_identification import require_motion
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_parameters import ServoUnknowns
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.servo_starts import first_start
from skewmi.calibration.uncertainty import autocorrelation_time, fit_covariance
from skewmi.errors import ConfigurationError
from skewmi.robot_models.servo import ServoParameters
from skewmi.robot_models.yumi import Array
from skewmi.trajectory import GRID_S, JointTrajectory

SUCH_GAINS = (2.0, 5.0, 10.0, 20.0)
SUCH_LOW_PASSES_HZ = (3.0, 8.0, 20.0, 60.0)
"""Laws that are tried besides the announced one, 1/s and Hz."""
KEPT = 2
"""Of them, how many are followed on."""
FIRST_ITERATIONS, ITERATIONS, ITERATIONS_AGAIN = 10, 15, 5
START_S = 6.0
"""Of a motion that starts are compared by, s."""


@dataclass(frozen=True, eq=False)
class EgmIdentification:
    """What was found, in times of a clock.

    Attributes:
        arm: Law, lag and servos.
        estimates: `gain` (1/s), `low_pass` (Hz), `delay` (the lag of all, s), `lag` (of each joint
            at a steady speed, its servo included, s), and those of the servos as in
            `ServoIdentification`, but for the armature.
        residual_rms: Of simulated less measured positions, rad. Shape (7,).
        autocorrelation_time: Of the residuals, in samples; 1 is white. Shape (7,).
        nominal_rms: Residual of the announced law and nominal servos without a lag, rad.
        period_s: Of the controller's cycle.
        speed_share: Part of the speed that was sent as speed reference.
        seconds_of_motion: That were used.
        at_the_end: What is as far as it is searched.
    """

    arm: EgmArm
    estimates: Mapping[str, Estimate]
    residual_rms: Array
    autocorrelation_time: Array
    nominal_rms: float
    period_s: float
    speed_share: float
    seconds_of_motion: float
    at_the_end: Sequence[str]


class EgmIdentifier:
    """Identifies one arm from one or more recordings made through EGM.

    Args:
        servos: Simulates what is behind the law.
        recordings: In free space.
        nominal: Servos that the search is about; force limits and armature are taken for known.
        announced: The law that the bridge was told.
        inertia_uncertainty: As in `ServoIdentifier`.

    Raises:
        ConfigurationError: There is no recording, they were made with different cycles or
            shares of the speed, or an arm does not move in one.
    """

    def __init__(
        self,
        servos: ServoModel,
        recordings: Sequence[EgmRecording],
        nominal: ServoParameters,
        announced: EgmLaw,
        inertia_uncertainty: float = 0.0,
    ) -> None:
        if not recordings:
            raise ConfigurationError("a law is identified from one recording at least; got none")
        first = recordings[0]
        for other in recordings:
            require_motion(other.motion)
            if (
                abs(other.period_s / first.period_s - 1.0) > SAME_PERIOD
                or other.speed_share != first.speed_share
            ):
                raise ConfigurationError(
                    f"recordings with cycles of {1e3 * first.period_s:.3f} and "
                    f"{1e3 * other.period_s:.3f} ms and {first.speed_share:g} and "
                    f"{other.speed_share:g} of the speed sent are of different set-ups; "
                    "identify from those of one"
                )
        self._stretch, self._first = first.stretch, first
        # Everything here counts in cycles, each of them for 4 ms.
        law = EgmLaw(announced.gain * self._stretch, announced.low_pass_hz * self._stretch)
        self._model = EgmModel(servos, first.speed_share)
        self._recordings = tuple(recording.motion for recording in recordings)
        self._unknowns = EgmUnknowns(nominal, law, servos.velocity_lead)
        self._inertia = inertia_uncertainty

    def run(self) -> EgmIdentification:
        """Identify."""
        unknowns, weight = self._unknowns, np.full(7, 1.0 / RESOLUTION)
        # Most of the way on a part of the motion, at a part of the time.
        begun = self._recordings[0].shortened(self._recordings[0].motion_begins_s + START_S)
        short = (begun,)
        found = [
            self._minimised(start, weight, short, FIRST_ITERATIONS) for start in self._starts(begun)
        ]
        # The joints by their smallest residual: one that is far off must not decide for all.
        size = (self._residual(np.array(found).T, short) ** 2).mean(axis=0)
        best = int(np.argmin((size / size.min(axis=1, keepdims=True)).sum(axis=0)))
        vector = self._minimised(found[best], weight, self._recordings, ITERATIONS)
        residual = self._residual(vector[:, None], self._recordings)[..., 0]
        weight = 1.0 / joint_sigma(residual, self._unknowns.size)
        vector = self._minimised(vector, weight, self._recordings, ITERATIONS_AGAIN)
        residual = self._residual(vector[:, None], self._recordings)[..., 0]
        seconds = sum(float(np.ptp(r.times_s)) for r in self._recordings)
        covariance = fit_covariance(
            residual,
            self._jacobian(vector),
            weight,
            joint_sigma(residual, self._unknowns.size),
            round(HANG_TOGETHER_S * len(residual) / seconds),
        )
        far = unknowns.vector(EgmArm(unknowns.announced, DelayedServo(unknowns.nominal, 0.0)))
        return EgmIdentification(
            arm=unknowns.arm(vector).slower(self._stretch),
            estimates=egm_estimates(unknowns, vector, covariance, self._inertia, self._stretch),
            residual_rms=joint_rms(residual),
            autocorrelation_time=np.array([autocorrelation_time(c) for c in residual.T]),
            nominal_rms=float(
                np.sqrt((self._residual(far[:, None], self._recordings) ** 2).mean())
            ),
            period_s=self._first.period_s,
            speed_share=self._first.speed_share,
            seconds_of_motion=seconds * self._stretch,
            at_the_end=unknowns.at_the_end(vector),
        )

    def _starts(self, recording: ServoRecording) -> list[Array]:
        """Vectors to begin from: servos that suit the announced law, and laws that suit these."""
        unknowns, model = self._unknowns, self._model
        commands = recording.commands
        (q,), (v,) = desired_motions(
            [unknowns.announced], commands.q, model.speed_share * commands.v, GRID_S
        )
        behind = ServoRecording(
            JointTrajectory(q, v, np.zeros_like(q)), recording.times_s, recording.positions
        )
        servos = ServoUnknowns(unknowns.nominal)
        servo = servos.servo(first_start(model.servos, servos, behind))
        laws = [
            unknowns.announced,
            *(EgmLaw(gain, corner) for gain, corner in product(SUCH_GAINS, SUCH_LOW_PASSES_HZ)),
        ]
        arms = [EgmArm(law, servo) for law in laws]
        error = model.positions(arms, recording) - recording.positions
        size = (error**2).mean(axis=1)
        order = np.argsort((size / size.min(axis=0)).sum(axis=1))
        chosen = [0, *(int(k) for k in order if k)][:KEPT]
        return [unknowns.vector(arms[k]) for k in chosen]

    def _residual(self, vectors: Array, recordings: Sequence[ServoRecording]) -> Array:
        """Simulated less measured positions, rad. (p, k) -> (m, 7, k)."""
        arms = [self._unknowns.arm(column) for column in vectors.T]
        parts = [
            (self._model.positions(arms, recording) - recording.positions)[:, settled(recording)]
            for recording in recordings
        ]
        residual: Array = np.concatenate(parts, axis=1).transpose(1, 2, 0)
        return residual

    def _minimised(
        self,
        vector: Array,
        weight: Array,
        recordings: Sequence[ServoRecording],
        iterations: int,
    ) -> Array:
        def residual(vectors: Array) -> Array:
            return self._residual(vectors, recordings)

        def jacobian(at: Array) -> Array:
            return self._quick_jacobian(at, recordings)

        return minimised(residual, vector, weight, self._unknowns.bounds(), iterations, jacobian)

    def _quick_jacobian(self, vector: Array, recordings: Sequence[ServoRecording]) -> Array:
        """For the way to the minimum: as if no joint moved another, rad. Shape (m, 7, p).

        Then the seven numbers of a kind are changed at once, and each joint tells its own: six
        motions instead of twenty-four.
        """
        low, high = self._unknowns.bounds()
        kinds = [slice(0, 7), slice(7, 14), slice(14, 21), *range(21, len(vector))]
        step = STEP * np.maximum(1.0, np.abs(vector))
        step = np.where(vector + step > high, -step, step)
        moved = np.tile(vector[:, None], (1, len(kinds) + 1))
        for column, kind in enumerate(kinds):
            moved[kind, column + 1] += step[kind]
        moved = np.clip(moved, low[:, None], high[:, None])
        positions = self._residual(moved, recordings)
        change = positions[..., 1:] - positions[..., :1]
        found = np.zeros((*change.shape[:2], len(vector)))
        for column, kind in enumerate(kinds):
            if isinstance(kind, slice):
                joints = np.arange(7)
                found[:, joints, kind.start + joints] = change[:, :, column] / step[kind]
            else:
                found[:, :, kind] = change[:, :, column] / step[kind]
        return found

    def _jacobian(self, vector: Array) -> Array:
        """By one-sided differences, to where the bounds leave room, rad. Shape (m, 7, p)."""
        _, high = self._unknowns.bounds()
        step = STEP * np.maximum(1.0, np.abs(vector))
        step = np.where(vector + step > high, -step, step)
        moved = np.column_stack((vector, vector[:, None] + np.diag(step)))
        positions = self._residual(moved, self._recordings)
        return (positions[..., 1:] - positions[..., :1]) / step


def egm_position_rms(servos: ServoModel, arm: EgmArm, recording: EgmRecording) -> Array:
    """RMS of an arm's simulated less measured positions, rad. Shape (7,).

    Args:
        servos: Simulates what is behind the law.
        arm: In times of a clock.
        recording: To compare with.
    """
    motion = recording.motion
    model = EgmModel(servos, recording.speed_share)
    error = model.positions([arm.slower(1.0 / recording.stretch)], motion)[0] - motion.positions
    return joint_rms(error[settled(motion)])
