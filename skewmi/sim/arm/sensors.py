"""Sensors with errors, and servos that get their targets late: a variation beside the models."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array
from skewmi.sim.arm.arm_task import ArmTask
from skewmi.sim.arm.definition import SIM_DT
from skewmi.sim.arm.variation_keys import DELAY_MS, JOINT_NOISE
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


def delay_substeps(sample: VariationSample) -> NDArray[np.int64]:
    """Delay of the servos in time steps of the physics. Shape (n,)."""
    return np.rint(sample.get(DELAY_MS) / (SIM_DT * 1e3)).astype(np.int64)


def sensors_err(variation: ModelVariation, arm: ArmTask) -> bool:
    """Whether a variation has errors of any sensor."""
    keys = [key for joint in arm.joints for key in (joint.bias_key, joint.noise_key) if key]
    return variation.has(JOINT_NOISE, *keys)


class SensorErrors:
    """Bias, constant in an episode, and white noise of the sensors.

    Args:
        sample: Values drawn.
        arm: Names the keys of the scene's joints.
    """

    def __init__(self, sample: VariationSample, arm: ArmTask) -> None:
        self._n = sample.n
        self._joint_noise = sample.get(JOINT_NOISE)

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
        return (
            self._joint_noise[:, None] * white[:, :7],
            self._bias + self._noise * white[:, 7:],
        )
