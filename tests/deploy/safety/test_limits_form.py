"""The form of chunks that the checker takes, and of what it gives back."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from limit_chunks import CHECKER, JERK, LAB, NAMES, SIGNED_JOINTS, H, refusal, still, verdict

from skewmi.deploy.safety.limits import ChunkChecker, LimitUsage
from skewmi.errors import ConfigurationError


def test_motions_in_progress_have_three_parts() -> None:
    chunk = still(4)
    short = (chunk[0][0], chunk[1][0])
    for option in ("previous", "before"):
        with pytest.raises(ValueError, match=r"zip\(\) argument"):
            CHECKER.check(*chunk, **{option: short})  # type: ignore[arg-type]


def test_use_of_the_jerk_counts_in_both_directions() -> None:
    for (joint, sign), factor in itertools.product(SIGNED_JOINTS, (0.01, 0.1, 0.3)):
        q, v, a = still(2)
        a[0, joint] = sign * factor * JERK * H
        usage = CHECKER.check(q, v, a, previous=(q[0], v[0], a[0]))
        assert usage.jerk == pytest.approx(factor, rel=1e-12)


def test_usage_is_plain_numbers() -> None:
    """Of which reports and recordings are made."""
    usage = CHECKER.check(*still(4)).as_dict()
    assert {type(value) for value in usage.values()} == {float}


def test_from_two_samples_to_five_seconds() -> None:
    for n in (2, 3, 1249, 1250):
        CHECKER.check(*still(n), time_from_start_ns=np.arange(n) * 4_000_000)
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


@pytest.mark.parametrize(
    ("names", "in_place"),
    [
        ([NAMES[1], NAMES[0], *NAMES[2:]], 5),
        (list(NAMES[:6]), 6),
        ((*NAMES, *"abcde"), 7),
        ([], 0),
    ],
)
def test_names_in_place_are_counted_and_ten_shown(names: Sequence[str], in_place: int) -> None:
    error = refusal(CHECKER, *still(4), joint_names=names)
    assert (error.limit, error.value, error.bound) == ("joint names in place", in_place, 7)
    assert f"got {list(names[:10])}, expected {list(NAMES)}" in str(error)


def test_names_may_be_given_as_a_list() -> None:
    names = list(NAMES)
    checker = ChunkChecker(LAB, joint_names=names)
    names.reverse()
    checker.check(*still(4), joint_names=list(NAMES))


@pytest.mark.parametrize("off", [-1, 1, 2, 4_000_000])
@pytest.mark.parametrize("row", range(4))
def test_times_off_the_grid_say_how_far(off: int, row: int) -> None:
    times = np.arange(4, dtype=np.int64) * 4_000_000
    times[row] += off
    error = refusal(CHECKER, *still(4), time_from_start_ns=times)
    assert (error.value, error.bound, type(error.value)) == (abs(off), 0, int)
    assert "grid step 4000000 ns" in str(error)


@pytest.mark.parametrize("shape", [(3,), (5,), (4, 1), (0,)])
def test_as_many_times_as_samples(shape: tuple[int, ...]) -> None:
    error = refusal(CHECKER, *still(4), time_from_start_ns=np.zeros(shape, dtype=np.int64))
    assert (error.limit, error.value, error.bound) == ("chunk times", math.prod(shape), 4)


def test_any_grid_of_whole_nanoseconds() -> None:
    for tenths_ms in (*range(1, 200), 9000):
        step_ns = tenths_ms * 100_000
        checker = ChunkChecker(LAB, grid_dt=step_ns / 1e9)
        checker.check(*still(3), time_from_start_ns=np.arange(3) * step_ns)
        assert verdict(checker, *still(3), time_from_start_ns=np.arange(3) * (step_ns + 1))


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
