"""The law by which a controller follows references of externally guided motion (EGM).

ABB's application manual 3HAC073318 (RobotWare 7.16), p. 26 and 29:

    speed = low-pass(k (position reference - desired position) + speed reference)

cycle by cycle, with the controller's own desired position. Here it is computed for whole motions
and many candidates at once. Left out is what a calibration's motion must not do: ramps at the ends
of a session, and joints that are slowed down because one is too fast.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, pi

import numpy as np

from skewmi.errors import ConfigurationError
from skewmi.robot_models.yumi import Array

LARGEST_GAIN = 100.0
LARGEST_LOW_PASS_HZ = 200.0
"""Largest that is taken for a law; ABB allows a gain of 20 /s and 100 Hz."""


@dataclass(frozen=True)
class EgmLaw:
    """Constants of the law, the same for all joints.

    Attributes:
        gain: k, 1/s.
        low_pass_hz: Corner of the low-pass, of first order, Hz.

    Raises:
        ConfigurationError: They are none.
    """

    gain: float
    low_pass_hz: float

    def __post_init__(self) -> None:
        for name, largest in (("gain", LARGEST_GAIN), ("low_pass_hz", LARGEST_LOW_PASS_HZ)):
            value = getattr(self, name)
            if not (isfinite(value) and 0.0 < value <= largest):
                raise ConfigurationError(
                    f"EGM {name} is {value}; it must be positive and {largest:g} at most"
                )


def desired_motions(
    laws: Sequence[EgmLaw],
    q: Array,
    v: Array,
    period_s: float,
    start: tuple[Array, Array] | None = None,
) -> tuple[Array, Array]:
    """What a controller wants of its servos.

    Args:
        laws: c of them.
        q: Position reference of every cycle, rad. Shape (n, 7).
        v: Speed reference of every cycle, rad/s. Shape (n, 7).
        period_s: Of a cycle.
        start: Desired position, rad, and speed, rad/s, before the first cycle, each of shape (7,);
            at rest at the first reference if not given.

    Returns:
        Desired position, rad, and speed, rad/s, once each cycle's reference has been read. Each
        shape (c, n, 7).
    """
    gain = np.array([law.gain for law in laws])[:, None]
    corner = np.array([law.low_pass_hz for law in laws])[:, None]
    share = 1.0 - np.exp(-2.0 * pi * corner * period_s)
    positions = np.empty((len(laws), *q.shape))
    speeds = np.empty_like(positions)
    at_first = (q[0], np.zeros_like(q[0])) if start is None else start
    desired, speed = (np.tile(part, (len(laws), 1)) for part in at_first)
    for index, (position_reference, speed_reference) in enumerate(zip(q, v, strict=True)):
        asked = gain * (position_reference - desired) + speed_reference
        speed = speed + share * (asked - speed)
        desired = desired + period_s * speed
        positions[:, index], speeds[:, index] = desired, speed
    return positions, speeds
