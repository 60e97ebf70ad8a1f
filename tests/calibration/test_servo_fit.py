"""The least squares that servos are found with, beside SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from skewmi.calibration.servo_fit import minimised
from skewmi.policy_io import Array

ROWS = 12


@pytest.mark.parametrize("given_slopes", [False, True])
@pytest.mark.parametrize("part", range(10))
def test_nothing_beyond_the_bounds_is_tried_or_found(part: int, given_slopes: bool) -> None:
    """Not by a rounding error either, as in three of a hundred of these without care: a friction of
    -5e-19 N m is none that can be simulated."""
    for number in range(30):
        check(np.random.default_rng([part, number]), given_slopes)


def check(rng: np.random.Generator, given_slopes: bool) -> None:
    """Of a random problem."""
    size = int(rng.integers(1, 7))
    slopes = rng.normal(size=(ROWS * 7, size))
    # A bound at nothing, which sums do not meet by themselves, and minima beyond it.
    low, high = np.zeros(size), rng.uniform(0.1, 3.0, size)
    goal = slopes @ rng.uniform(-1.0, 4.0, size) + 0.1 * rng.normal(size=ROWS * 7)
    tried: list[Array] = []

    def residual(vectors: Array) -> Array:
        tried.append(vectors.copy())
        return (slopes @ vectors - goal[:, None]).reshape(ROWS, 7, -1)

    def jacobian(vector: Array) -> Array:
        tried.append(vector[:, None].copy())
        return slopes.reshape(ROWS, 7, size)

    begin = rng.uniform(low, high)
    slopes_of = jacobian if given_slopes else None
    found = minimised(residual, begin, np.ones(7), (low, high), 60, slopes_of)
    everything = np.column_stack([*tried, found])
    assert (everything >= low[:, None]).all()
    assert (everything <= high[:, None]).all()
    expected = lsq_linear(slopes, goal, (low, high), method="bvls").x
    np.testing.assert_allclose(found, expected, atol=1e-4)
