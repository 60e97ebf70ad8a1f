"""The fraction of power above a frequency, against sums of waves and a Fourier sum by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.smoothness import LIMITS, bands, name_of, power_above, smoothness, spectrum

DT = 0.004


def test_waves_count_where_they_are() -> None:
    t = DT * np.arange(250)
    slow, fast, faster = (np.sin(2 * np.pi * f * t) for f in (4.0, 12.0, 40.0))
    a = np.stack([slow, fast, slow + 0.5 * fast + 0.1 * faster], axis=1)
    np.testing.assert_allclose(power_above(a, DT, 10.0), [0.0, 1.0, 0.26 / 1.26], atol=1e-12)
    np.testing.assert_allclose(power_above(a, DT, 20.0), [0.0, 0.0, 0.01 / 1.26], atol=1e-12)
    assert smoothness(a, DT)["power_above_10_hz"] == pytest.approx(1.0)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 90))
def test_power_is_that_of_the_samples(seed: int, n: int) -> None:
    a = np.random.default_rng(seed).normal(size=(n, 3))
    frequencies, power = spectrum(a, DT)
    np.testing.assert_allclose(power.sum(axis=0), n * (a * a).sum(axis=0))
    k = np.arange(n)
    by_hand = np.abs(np.exp(-2j * np.pi * np.outer(k, k) / n) @ a) ** 2
    both_sides = np.minimum(k, n - k) / (n * DT)
    for frequency in (10.0, 20.0, 77.0):
        expected = by_hand[both_sides > frequency + 1e-9].sum(axis=0) / by_hand.sum(axis=0)
        clear = np.abs(frequencies - frequency) > 1e-6
        if clear.all():
            np.testing.assert_allclose(power_above(a, DT, frequency), expected, atol=1e-12)


def test_nothing_moves_nothing_shakes() -> None:
    assert smoothness(np.zeros((10, 7)), DT) == {}
    assert smoothness(np.zeros((0, 7)), DT) == {}
    assert {name_of(f) for f in LIMITS} == {"power_above_10_hz", "power_above_20_hz"}


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 90))
def test_bands_are_the_power_between_two_frequencies(seed: int, n: int) -> None:
    a = np.random.default_rng(seed).normal(size=(n, 3))
    frequencies, power = spectrum(a, DT)
    found = bands(a, DT, 30)
    assert found.sum() == pytest.approx(1.0)
    for low in range(30):
        inside = (frequencies >= low) & (frequencies < low + 1)
        assert found[low] == pytest.approx(power[inside].sum() / power.sum())
    assert not bands(np.zeros((5, 7)), DT, 30).any()
