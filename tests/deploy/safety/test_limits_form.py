"""The form of chunks that the checker takes, and of what it gives back."""

from __future__ import annotations

import itertools
import math
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from limit_chunks import CHECKER, JERK, LAB, SIGNED_JOINTS, H, refusal, still

from skewmi.deploy.safety.limits import ChunkChecker, LimitUsage
from skewmi.errors import ConfigurationError
from skewmi.trajectory import JointPoint


def test_motions_in_progress_have_three_parts() -> None:
    chunk = still(4)
    short = (chunk[0][0], chunk[1][0])
    with pytest.raises(ValueError, match=r"zip\(\) argument"):
        CHECKER.check(*chunk, short)  # type: ignore[arg-type]


def test_use_of_the_jerk_counts_in_both_directions() -> None:
    for (joint, sign), factor in itertools.product(SIGNED_JOINTS, (0.01, 0.1, 0.3)):
        q, v, a = still(2)
        a[0, joint] = sign * factor * JERK * H
        usage = CHECKER.check(q, v, a, previous=JointPoint(q[0], v[0], a[0]))
        assert usage.jerk == pytest.approx(factor, rel=1e-12)


def test_usage_is_plain_numbers() -> None:
    """Of which reports and recordings are made."""
    usage = CHECKER.check(*still(4)).as_dict()
    assert {type(value) for value in usage.values()} == {float}


def test_from_two_samples_to_five_seconds() -> None:
    for n in (2, 3, 1249, 1250):
        CHECKER.check(*still(n))
    for n in (0, 1, 1251, 1252):
        error = refusal(CHECKER, *still(n))
        assert (error.limit, error.value, error.bound) == ("chunk samples", n, 1250)
        assert "at least 2" in str(error)


@pytest.mark.parametrize("which", [0, 1, 2])
@pytest.mark.parametrize("shape", [(3, 7), (5, 7), (4, 6), (4, 8), (4,), (4, 7, 1), (0, 7)])
def test_other_shapes_are_named(which: int, shape: tuple[int, ...]) -> None:
    chunk = list(still(4))
    chunk[which] = np.zeros(shape)
    error = refusal(CHECKER, *chunk)
    assert (error.limit, error.bound) == ("chunk shape", 7)
    # The other two are compared with q.
    named, size = (
        ("v", 28)
        if which == 0 and len(shape) == 2 and shape[1] == 7
        else (
            "qva"[which],
            math.prod(shape),
        )
    )
    assert error.value == size
    assert f"{named} has shape" in str(error)


@pytest.mark.parametrize("which", [0, 1, 2])
def test_numbers_that_are_not_finite_are_named(which: int) -> None:
    chunk = still(4)
    chunk[which][2, 3] = math.nan
    error = refusal(CHECKER, *chunk)
    assert math.isnan(error.value)
    assert error.bound == 0.0
    assert str(error).endswith(f"(in {'qva'[which]})")


@pytest.mark.parametrize("value", [0.0, -1e-9, -1.0, math.nan])
@pytest.mark.parametrize("name", ["grid_dt", "tcp_speed"])
def test_steps_and_speeds_must_be_positive(name: str, value: float) -> None:
    with pytest.raises(ConfigurationError, match=f"^{name} is {value}; it must be positive"):
        ChunkChecker(LAB, **{name: value})  # type: ignore[arg-type]


def test_no_use_is_zero_and_cannot_be_changed() -> None:
    usage = LimitUsage()
    assert set(usage.as_dict().values()) == {0.0}
    assert len(usage.as_dict()) == 6
    with pytest.raises(FrozenInstanceError):
        usage.velocity = 1.0  # type: ignore[misc]
