"""The stream that a receiver gets: the motion before, a chunk however short, and rest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.safety.limits import GRID_DT, ChunkChecker
from skewmi.errors import LimitViolationError
from skewmi.policy_io import Array
from skewmi.robot_models import limits

LAB = limits.profile("lab")
CHECKER = ChunkChecker(LAB)
MIDDLE = (LAB.position_lower + LAB.position_upper) / 2.0
BOUNDS = (LAB.velocity * GRID_DT, LAB.acceleration * GRID_DT**2, LAB.jerk * GRID_DT**3)
"""Of differences of positions, first to third."""
Chunk = tuple[Array, Array, Array]


def chunk_to_rest(jerks: Array) -> Chunk:
    """Samples of a motion that ends at rest in the middle, its jerk constant on each grid step.

    Args:
        jerks: Fractions of the limit. Shape (n - 1, 7).
    """
    h, states = GRID_DT, [(MIDDLE, np.zeros(7), np.zeros(7))]
    for fractions in jerks[::-1]:
        (q, v, a), j = states[-1], fractions * LAB.jerk
        states.append(
            (q - h * v + h * h * a / 2 - h**3 * j / 6, v - h * a + h * h * j / 2, a - h * j)
        )
    q, v, a = (np.array(part) for part in zip(*states[::-1], strict=True))
    return q, v, a


def motion_before(q: Array, third: Array) -> Array:
    """Three samples before a chunk that give the stream these third differences; (3, 7) each."""
    stream = [*q, q[-1], q[-1], q[-1]]
    for difference in third:
        stream.insert(0, 3 * stream[0] - 3 * stream[1] + stream[2] - difference)
    return np.array(stream[:3])


def largest_fraction(earlier: Array, q: Array) -> float:
    """Of any bound, by differences of the whole stream, window by window."""
    stream = [*earlier, *q, q[-1], q[-1], q[-1]]
    fractions = [0.0]
    for k in range(1, len(stream)):
        differences = [stream[k] - stream[k - 1]]
        if k > 1:
            differences.append(stream[k] - 2 * stream[k - 1] + stream[k - 2])
        if k > 2:
            differences.append(stream[k] - 3 * stream[k - 1] + 3 * stream[k - 2] - stream[k - 3])
        for difference, bound in zip(differences, BOUNDS, strict=False):
            fractions.append(float((np.abs(difference) / bound).max()))
    return max(fractions)


def check(chunk: Chunk, earlier: Array) -> None:
    """As a robot server does that would be where the chunk starts."""
    CHECKER.check(*chunk, previous=(chunk[0][0], chunk[1][0], chunk[2][0]), earlier=earlier)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("joint", range(7))
def test_two_samples_between_a_motion_and_rest(joint: int, sign: float) -> None:
    """The one window that reaches over both ends of a chunk: before, both samples, after."""
    unit = sign * LAB.jerk[joint] * GRID_DT ** np.array([3.0, 2.0, 1.0])
    for fraction, accepted in ((1 - 1e-4, True), (1 + 1e-4, False)):
        q, v, a = np.tile(MIDDLE, (2, 1)), np.zeros((2, 7)), np.zeros((2, 7))
        q[1, joint] += 0.1 * unit[0]
        v[0, joint], a[0, joint] = 0.3 * unit[1], -0.3 * unit[2]
        third = np.zeros((3, 7))
        third[0, joint] = fraction * unit[0]
        earlier = motion_before(q, third)
        assert largest_fraction(earlier, q) == pytest.approx(fraction, abs=1e-6)
        if accepted:
            check((q, v, a), earlier)
        else:
            with pytest.raises(LimitViolationError, match=f"jerk over an end.*joint index {joint}"):
                check((q, v, a), earlier)


@settings(max_examples=200, deadline=None)
@given(st.integers(2, 6), st.sampled_from([0.4, 0.9, 1.0, 1.02, 1.3]), st.integers(0, 2**32 - 1))
def test_what_passes_is_what_keeps_the_limits_as_one_stream(n: int, size: float, seed: int) -> None:
    """Chunks so short that jerk is broken first; motions before that go too far or not."""
    rng = np.random.default_rng(seed)
    chunk = chunk_to_rest(rng.uniform(-0.9, 0.9, (n - 1, 7)))
    third = size * LAB.jerk * GRID_DT**3 * rng.choice([-1.0, 0.0, 1.0], (3, 7))
    earlier = motion_before(chunk[0], third)
    fraction = largest_fraction(earlier, chunk[0])
    if fraction <= 1.0 + 1e-7:
        check(chunk, earlier)
    elif fraction > 1.0 + 1e-5:
        with pytest.raises(LimitViolationError, match="over an end"):
            check(chunk, earlier)
