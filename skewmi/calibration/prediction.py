"""How well a motion would tell the servos, before it is made: half-widths of the intervals.

With white noise on the positions alone. What the model lacks makes the intervals of a real
recording wider, by as much for one motion as for another: to choose among motions this will do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_parameters import ServoUnknowns
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.uncertainty import TWO_SIDED_95, UNTOLD, inverse_of
from skewmi.trajectory import CYCLE_TICKS, GRID_S, Array, JointTrajectory

STEP = 1e-3
JOINT_NOISE = 1e-4
"""Standard deviation of a measured joint angle that is reckoned with, rad."""
LIKELY_DELAY_S = 0.02


@dataclass(frozen=True, eq=False)
class PredictedHalfWidth:
    """Of 95 % intervals.

    Attributes:
        kp, kd: As a part of the value. Each shape (7,).
        frictionloss: N m. Shape (7,).
        delay_ms: ms.
    """

    kp: Array
    kd: Array
    frictionloss: Array
    delay_ms: float

    @property
    def worst(self) -> float:
        """What motions are chosen by: the largest, friction in tenths of a N m, delay in ms."""
        return float(
            max(self.kp.max(), self.kd.max(), self.frictionloss.max() / 0.1, self.delay_ms)
        )

    def as_dict(self) -> dict[str, object]:
        return {
            "kp": self.kp.tolist(),
            "kd": self.kd.tolist(),
            "frictionloss": self.frictionloss.tolist(),
            "delay_ms": self.delay_ms,
        }


def predicted_half_width(
    model: ServoModel,
    motion: JointTrajectory,
    servo: DelayedServo,
    joint_noise: float = JOINT_NOISE,
) -> PredictedHalfWidth:
    """What identification from positions every 20 ms would come to.

    Args:
        model: That would be identified with.
        motion: To be made.
        servo: That is likely.
        joint_noise: Standard deviation of a reading, rad.
    """
    unknowns = ServoUnknowns(servo.parameters)
    vector = unknowns.vector(servo)
    times: Array = GRID_S * np.arange(0.0, len(motion), CYCLE_TICKS)
    recording = ServoRecording(motion, times, np.tile(motion.q[0], (len(times), 1)))
    _, high = unknowns.bounds()
    step = STEP * np.maximum(1.0, np.abs(vector))
    step = np.where(vector + step > high, -step, step)
    candidates = [unknowns.servo(vector)]
    candidates += [unknowns.servo(vector + row) for row in np.diag(step)]
    positions = model.positions(candidates, recording)
    jacobian = ((positions[1:] - positions[0]) / step[:, None, None]).reshape(len(vector), -1)
    information = jacobian @ jacobian.T / joint_noise**2
    covariance = inverse_of(information) + np.diag(UNTOLD * (np.diag(information) <= 0.0))
    half = {
        name: TWO_SIDED_95 * np.sqrt(np.einsum("ki,ij,kj->k", rows, covariance, rows).clip(min=0.0))
        for name, rows in unknowns.derivatives(vector).items()
    }
    return PredictedHalfWidth(
        half["kp"], half["kd"], half["frictionloss"], 1e3 * float(half["delay"][0])
    )
