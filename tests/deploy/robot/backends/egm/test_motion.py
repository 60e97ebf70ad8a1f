"""What packets tell of the motion: speed and delay."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.robot.backends.egm.motion import DelayEstimate, SpeedEstimate
from skewmi.trajectory import Array

PERIOD_S = 0.004032
CYCLES = 1000


def test_speed_is_taken_from_positions() -> None:
    estimate = SpeedEstimate()
    rng = np.random.default_rng(2)
    v = rng.uniform(-1, 1, 7)
    for number in range(20):
        speed = estimate.add(number * 4.032e6, v * number * 0.004032)
    np.testing.assert_allclose(speed, v, atol=1e-9)
    estimate.forget()
    np.testing.assert_array_equal(estimate.add(0.0, v), np.zeros(7))


def swaying(seed: int, hz: float) -> tuple[Array, Array, Array]:
    """Amplitudes, angular frequencies and phases of a motion of all joints."""
    rng = np.random.default_rng(seed)
    omega = 2.0 * np.pi * hz * rng.uniform(0.5, 1.0, 7)
    return 0.4 * rng.uniform(0.5, 1.0, 7) / omega, omega, rng.uniform(0.0, 2.0 * np.pi, 7)


def watch(
    delay_s: float, motion: tuple[Array, Array, Array], *, loss: float = 0.0, noise: float = 0.0
):
    """An estimate that has seen four seconds of an arm that is late by so much."""
    amplitude, omega, phase = motion
    rng = np.random.default_rng(1)
    sag = rng.uniform(-0.02, 0.02, 7)
    estimate = DelayEstimate()
    for t in PERIOD_S * np.arange(CYCLES):
        if rng.random() < loss:
            continue
        commanded = amplitude * np.sin(omega * t + phase)
        measured = amplitude * np.sin(omega * (t - delay_s) + phase) + sag
        estimate.add(t, commanded, measured + noise * rng.standard_normal(7))
    return estimate


@settings(deadline=None, max_examples=20)
@given(
    delay_s=st.floats(0.0, 0.130),
    seed=st.integers(0, 1000),
    hz=st.floats(0.3, 3.0),
    loss=st.sampled_from([0.0, 0.1]),
    noise=st.sampled_from([0.0, 2e-4]),
)
def test_pure_delay_is_found(
    delay_s: float, seed: int, hz: float, loss: float, noise: float
) -> None:
    estimate = watch(delay_s, swaying(seed, hz), loss=loss, noise=noise)
    assert estimate.delay_s == pytest.approx(delay_s, abs=1e-3)


def test_resting_arm_has_none_and_takes_none_away() -> None:
    estimate = DelayEstimate()
    rng = np.random.default_rng(3)
    rest = rng.uniform(-1, 1, 7)
    for t in PERIOD_S * np.arange(CYCLES):
        estimate.add(t, rest, rest + 2e-4 * rng.standard_normal(7))
    assert estimate.delay_s is None
    moved = watch(0.030, swaying(0, 1.0))
    before = moved.delay_s
    moved.forget_way()
    for t in 10.0 + PERIOD_S * np.arange(CYCLES):
        moved.add(t, rest, rest)
    assert moved.delay_s == before == pytest.approx(0.030, abs=1e-3)


def test_even_sliding_cannot_be_told_from_an_offset() -> None:
    estimate = DelayEstimate()
    v = np.full(7, 0.1)
    for t in PERIOD_S * np.arange(CYCLES):
        estimate.add(t, v * t, v * (t - 0.030))
    assert estimate.delay_s is None


def test_arm_that_does_not_follow_has_none() -> None:
    estimate = DelayEstimate()
    amplitude, omega, phase = swaying(4, 1.0)
    for t in PERIOD_S * np.arange(CYCLES):
        estimate.add(t, amplitude * np.sin(omega * t + phase), np.zeros(7))
    assert estimate.delay_s is None


def test_what_was_commanded_in_an_ended_session_does_not_count() -> None:
    estimate = watch(0.020, swaying(5, 1.0))
    amplitude, omega, phase = swaying(5, 1.0)
    before = estimate.delay_s
    # Elsewhere, and a jump of the commands by a radian: not a word of it says anything of delays.
    for session in range(1, 40):
        estimate.forget_way()
        for t in session * 5.0 + PERIOD_S * np.arange(30):
            q = session + amplitude * np.sin(omega * t + phase)
            estimate.add(t, q, q)
    assert estimate.delay_s == before
