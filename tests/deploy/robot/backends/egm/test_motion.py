"""What packets tell of the motion: speed and delay."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skewmi.deploy.robot.backends.egm.motion import DelayEstimate, SpeedEstimate


def test_speed_is_taken_from_positions() -> None:
    estimate = SpeedEstimate()
    rng = np.random.default_rng(2)
    v = rng.uniform(-1, 1, 7)
    for number in range(20):
        speed = estimate.add(number * 4.032e6, v * number * 0.004032)
    np.testing.assert_allclose(speed, v, atol=1e-9)
    estimate.forget()
    np.testing.assert_array_equal(estimate.add(0.0, v), np.zeros(7))


@pytest.mark.parametrize("delay_s", [0.0, 0.010, 0.035])
def test_delay_is_found_from_a_motion(delay_s: float) -> None:
    estimate, dt = DelayEstimate(), 0.004032
    assert estimate.delay_s is None
    amplitude = np.linspace(0.05, 0.2, 7)
    for number in range(1000):
        t = number * dt
        commanded = amplitude * math.sin(2.0 * t)
        v = 2.0 * amplitude * math.cos(2.0 * t)
        measured = amplitude * math.sin(2.0 * (t - delay_s))
        estimate.add(commanded, v, measured, dt)
    assert estimate.delay_s == pytest.approx(delay_s, abs=5e-4)
