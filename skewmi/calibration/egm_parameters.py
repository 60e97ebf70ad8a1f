"""The unknowns of the identification of an arm behind EGM as one vector.

Those of the servos as in `servo_parameters`, without their delay; then the logarithms of the law's
gain and corner by announced ones; last the lag.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import exp, log

import numpy as np

from skewmi.calibration.egm_law import LARGEST_GAIN, LARGEST_LOW_PASS_HZ, EgmLaw
from skewmi.calibration.egm_model import EgmArm
from skewmi.calibration.servo_model import DelayedServo
from skewmi.calibration.servo_parameters import DELAY_UNIT_S, ServoUnknowns
from skewmi.robot_models.servo import ServoParameters
from skewmi.robot_models.yumi import Array
from skewmi.trajectory import GRID_S

LEAST_GAIN = 0.2
LEAST_LOW_PASS_HZ = 0.3
"""Smallest that is looked for."""
_SERVO = 21
AT_THE_END = 1e-3
"""How near to the end of what is searched a number counts as being there."""


@dataclass(frozen=True)
class EgmUnknowns:
    """Between vectors and arms.

    Attributes:
        nominal: Servos that the search is about.
        announced: The law that the bridge was told.
        velocity_lead: What the controller is taken to add to its servos' targets for their speed,
            as time, s. Shape (7,).
    """

    nominal: ServoParameters
    announced: EgmLaw
    velocity_lead: Array

    size = _SERVO + 3

    @cached_property
    def servos(self) -> ServoUnknowns:
        """Those of the servos."""
        return ServoUnknowns(self.nominal)

    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest vector. Each shape (24,)."""
        low, high = self.servos.bounds()
        law = self.announced
        return (
            np.concatenate(
                [
                    low[:_SERVO],
                    [log(LEAST_GAIN / law.gain), log(LEAST_LOW_PASS_HZ / law.low_pass_hz)],
                    low[-1:],
                ]
            ),
            np.concatenate(
                [
                    high[:_SERVO],
                    [log(LARGEST_GAIN / law.gain), log(LARGEST_LOW_PASS_HZ / law.low_pass_hz)],
                    high[-1:],
                ]
            ),
        )

    def vector(self, arm: EgmArm) -> Array:
        """Of an arm, within the bounds. Shape (24,)."""
        servo = self.servos.vector(arm.servo)
        law = (
            log(arm.law.gain / self.announced.gain),
            log(arm.law.low_pass_hz / self.announced.low_pass_hz),
        )
        low, high = self.bounds()
        within: Array = np.clip(np.concatenate([servo[:_SERVO], law, servo[-1:]]), low, high)
        return within

    def arm(self, vector: Array) -> EgmArm:
        """Of a vector."""
        gain = self.announced.gain * exp(vector[_SERVO])
        low_pass = self.announced.low_pass_hz * exp(vector[_SERVO + 1])
        law = EgmLaw(min(gain, LARGEST_GAIN), min(low_pass, LARGEST_LOW_PASS_HZ))
        return EgmArm(law, self.servo(vector))

    def servo(self, vector: Array) -> DelayedServo:
        """The part of a vector that is the servos'."""
        # An optimiser's rounding must not make a friction or the lag negative.
        low, high = self.servos.bounds()
        own = np.clip(np.append(vector[:_SERVO], vector[-1]), low, high)
        return self.servos.servo(own)

    def lags(self, vector: Array) -> Array:
        """How late each joint is behind its reference at a steady speed, s. Shape (7,).

        The law follows steady references without an error, if their speed is sent whole, and is
        ahead of the one that it has read by a cycle: it then wants what is due in the next one.
        """
        servo = self.servo(vector)
        own = servo.parameters
        lags: Array = servo.delay_s - GRID_S + own.kd / own.kp - self.velocity_lead
        return lags

    def derivatives(self, vector: Array) -> dict[str, Array]:
        """What intervals are given of, by the vector: of the servos as in `servo_parameters`,
        logarithms of the law's constants, lags in s. Each shape (7, 24) or (1, 24)."""
        one = np.eye(self.size)
        short = np.append(vector[:_SERVO], vector[-1])
        columns = [*range(_SERVO), self.size - 1]
        found = {}
        for name, rows in self.servos.derivatives(short).items():
            found[name] = np.zeros((len(rows), self.size))
            found[name][:, columns] = rows
        own = self.servo(vector).parameters
        ratio = (own.kd / own.kp)[:, None]
        found["lag"] = one[-1:] * DELAY_UNIT_S + ratio * one[7:14]
        found["gain"], found["low_pass"] = one[_SERVO : _SERVO + 1], one[_SERVO + 1 : _SERVO + 2]
        return found

    def at_the_end(self, vector: Array) -> list[str]:
        """What is as far as it is searched, in words: it would go on."""
        low, high = self.bounds()
        near = (vector - low < AT_THE_END) | (high - vector < AT_THE_END)
        words = []
        for name, columns in (("stiffness", range(7)), ("damping", range(7, 14))):
            joints = [column % 7 + 1 for column in columns if near[column]]
            if joints:
                words.append(f"{name} of the chain's joints {', '.join(map(str, joints))}")
        words += ["the gain"] * bool(near[_SERVO]) + ["the low-pass"] * bool(near[_SERVO + 1])
        return words
