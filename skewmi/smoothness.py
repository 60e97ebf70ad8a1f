"""How smooth a commanded motion is: the part of its acceleration that shakes an arm.

An arm on its stand resonates from some 10 Hz on, and a policy acts ten times a second: what its
commands have above that does not move the hand, it shakes it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIMITS: Mapping[float, float] = {10.0: 0.05, 20.0: 0.01}
"""Frequency, Hz -> largest fraction of the power of a joint's acceleration above it that counts as
smooth."""


def spectrum(acceleration: Array, dt: float) -> tuple[Array, Array]:
    """Power of each joint's acceleration by frequency.

    Args:
        acceleration: Of one motion that begins and ends at rest, rad/s^2. Shape (n, d).
        dt: Time between two samples, s.

    Returns:
        Frequencies, Hz, shape (n // 2 + 1,); power of each, shape (n // 2 + 1, d), whose sum is n
        times that of the squares of the accelerations.
    """
    power: Array = np.abs(np.fft.rfft(acceleration, axis=0)) ** 2
    # All but the mean and the highest stand for two frequencies each.
    power[1 : (len(acceleration) + 1) // 2] *= 2.0
    frequencies = np.asarray(np.fft.rfftfreq(len(acceleration), dt), dtype=np.float64)
    return frequencies, power


def power_above(acceleration: Array, dt: float, frequency_hz: float) -> Array:
    """Fraction of the power of each joint's acceleration above a frequency.

    Args:
        acceleration: See `spectrum`.
        dt: Time between two samples, s.
        frequency_hz: Above which.

    Returns:
        Shape (d,), in 0..1; 0 for a joint that does not accelerate.
    """
    if not len(acceleration):
        return np.zeros(acceleration.shape[1])
    frequencies, power = spectrum(acceleration, dt)
    above: Array = power[frequencies > frequency_hz].sum(axis=0)
    above /= np.maximum(power.sum(axis=0), np.finfo(np.float64).tiny)
    return above


def bands(acceleration: Array, dt: float, highest_hz: int) -> Array:
    """Fraction of the power of all joints' accelerations in each band of 1 Hz.

    Args:
        acceleration: See `spectrum`.
        dt: Time between two samples, s.
        highest_hz: End of the last band but one.

    Returns:
        Shape (highest_hz + 1,): from i to i + 1 Hz, and in the last all that is above; the sum is
        1, or 0 without any motion.
    """
    fractions = np.zeros(highest_hz + 1)
    if len(acceleration):
        frequencies, power = spectrum(acceleration, dt)
        band = np.minimum(frequencies.astype(int), highest_hz)
        np.add.at(fractions, band, power.sum(axis=1))
        fractions /= max(float(power.sum()), np.finfo(np.float64).tiny)
    return fractions


def name_of(frequency_hz: float) -> str:
    """Key of the JSON documents for a frequency of `LIMITS`, as `power_above_10_hz`."""
    return f"power_above_{frequency_hz:g}_hz"


def smoothness(acceleration: Array, dt: float) -> dict[str, float]:
    """`power_above` of the least smooth joint for the frequencies of `LIMITS`.

    Args:
        acceleration: See `spectrum`.
        dt: Time between two samples, s.

    Returns:
        By `name_of`; empty for no motion.
    """
    if not acceleration.any():
        return {}
    return {
        name_of(frequency): float(power_above(acceleration, dt, frequency).max())
        for frequency in LIMITS
    }
