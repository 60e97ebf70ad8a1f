"""Sensors with errors: a variation beside the models."""

from __future__ import annotations

import numpy as np

from skewmi.policy_io import Array
from skewmi.sim.arm.arm_task import ArmTask
from skewmi.sim.arm.variation_keys import (
    EFFORT_NOISE,
    JOINT_NOISE,
    JOINT_OFFSET,
    VELOCITY_NOISE,
)
from skewmi.sim.variation import ModelVariation, VariationSample

_STREAM = 1
"""Keeps a variation's random stream apart from that of the start positions."""


def random_stream(variation: ModelVariation, seed: int) -> np.random.Generator:
    """The stream that a variation's values and sensor errors are drawn from.

    Args:
        variation: Adds its own seed.
        seed: Of the environment or of the episode.
    """
    return np.random.default_rng([seed, variation.seed, _STREAM])


def sensors_err(variation: ModelVariation, arm: ArmTask) -> bool:
    """Whether a variation has errors of any sensor of a position."""
    keys = [key for joint in arm.joints for key in (joint.bias_key, joint.noise_key) if key]
    return variation.has(JOINT_NOISE, JOINT_OFFSET, *keys)


class SensorErrors:
    """Bias, constant in an episode, and white noise of the sensors.

    Args:
        sample: Values drawn.
        arm: Names the keys of the scene's joints.

    Attributes:
        joint_offset: Measured less true angle of the arm joints, rad, shape (n, 7); None if they
            are the same.
        rates_err: Whether the arm's velocities or efforts have noise.
    """

    def __init__(self, sample: VariationSample, arm: ArmTask) -> None:
        self._n = sample.n
        self._joint_noise = sample.get(JOINT_NOISE)
        self.joint_offset: Array | None = sample.values.get(JOINT_OFFSET)
        self._velocity_noise = sample.get(VELOCITY_NOISE)
        self._effort_noise = sample.get(EFFORT_NOISE)
        self.rates_err = bool(self._velocity_noise.any() or self._effort_noise.any())

        def of_joints(keys: list[str]) -> Array:
            columns = [
                np.radians(sample.get(key)) if key.endswith("_deg") else sample.get(key)
                for key in keys
            ]
            return np.array(columns).T.reshape(sample.n, len(keys))

        self._bias = of_joints([joint.bias_key for joint in arm.joints])
        self._noise = of_joints([joint.noise_key for joint in arm.joints])

    def draw(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Errors of one reading.

        Returns:
            Of the arm joints, rad, shape (n, 7); of the scene's joints, shape (n, joints).
        """
        white = rng.standard_normal((self._n, 7 + self._noise.shape[1]))
        joints = self._joint_noise[:, None] * white[:, :7]
        if self.joint_offset is not None:
            joints += self.joint_offset
        return joints, self._bias + self._noise * white[:, 7:]

    def draw_rates(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Errors of one reading of the arm's velocities, rad/s, and efforts, N m.

        For whoever tells these: an observation has neither.

        Returns:
            Each shape (n, 7).
        """
        white = rng.standard_normal((2, self._n, 7))
        return self._velocity_noise[:, None] * white[0], self._effort_noise[:, None] * white[1]
