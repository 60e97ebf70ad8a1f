"""Each rule of the robot server alone, dense around its bound; the bounds written out once more."""

from __future__ import annotations

import itertools
import math
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from skewmi.deploy.safety.validation import (
    MAX_GRIPPER_BYTES,
    BrokenStreamError,
    ValidationRules,
    check_fresh,
    check_rest,
    check_size,
    check_splice,
    check_structure,
    check_time,
)
from skewmi.errors import CommandRefusedError
from skewmi.trajectory import JointTrajectory, TrajectoryChunk

GRID_NS = 4_000_000
NAMES = ("first", "second", "third")
RULES = ValidationRules(NAMES, GRID_NS)
NOW = 1000
FIELDS = ("q", "v", "a")
LADDER = (0.0, 0.5, 0.9, 0.999, 1.001, 1.1, 2.0, 1e3, 1e9)
SIGNED_JOINTS = tuple(itertools.product(range(3), (1.0, -1.0)))


def chunk_of(n: int = 4, stamp_ns: int = NOW * GRID_NS) -> TrajectoryChunk:
    """An arm of three joints that rests at three angles."""
    q = np.tile([1.0, -2.0, 0.5], (n, 1))
    times = np.arange(n, dtype=np.int64) * GRID_NS
    return TrajectoryChunk(stamp_ns, NAMES, times, JointTrajectory(q, 0 * q, 0 * q))


def with_value(field: str, row: int, joint: int, value: float) -> TrajectoryChunk:
    chunk = chunk_of()
    getattr(chunk.trajectory, field)[row, joint] += value
    return chunk


def test_chunks_have_2_to_500_points() -> None:
    for n in (2, 3, 100, 499, 500):
        check_structure(chunk_of(n), RULES)
    for n in (0, 1, 501, 502, 5000):
        with pytest.raises(
            CommandRefusedError, match=f"^a chunk has 2 to 500 points; this has {n}$"
        ):
            check_structure(chunk_of(n), RULES)
    shorter = replace(RULES, max_points=3)
    check_structure(chunk_of(3), shorter)
    with pytest.raises(CommandRefusedError, match="2 to 3 points; this has 4"):
        check_structure(chunk_of(4), shorter)


def test_names_must_be_the_same_in_the_same_order() -> None:
    for names in (*itertools.permutations(NAMES), NAMES[:2], (*NAMES, "fourth"), ()):
        chunk = replace(chunk_of(), joint_names=names)
        if names == NAMES:
            check_structure(chunk, RULES)
            check_structure(replace(chunk, joint_names=list(names)), RULES)  # type: ignore[arg-type]
            continue
        with pytest.raises(CommandRefusedError) as caught:
            check_structure(chunk, RULES)
        assert str(caught.value) == (
            "joints must be first, second, third in this order; "
            f"got {', '.join(names) if names else 'none'}"
        )


@pytest.mark.parametrize("shape", [(3, 3), (5, 3), (4, 2), (4, 4), (0, 3), (4, 0), (0, 0)])
def test_samples_have_a_row_per_point_and_a_column_per_joint(shape: tuple[int, int]) -> None:
    samples = JointTrajectory(np.zeros(shape), np.zeros(shape), np.zeros(shape))
    with pytest.raises(CommandRefusedError) as caught:
        check_structure(replace(chunk_of(), trajectory=samples), RULES)
    assert f"samples must have shape (4, 3); got {shape}:" in str(caught.value)


@pytest.mark.parametrize("field", FIELDS)
def test_every_number_must_be_finite(field: str) -> None:
    for row, joint, value in itertools.product(range(4), range(3), (math.nan, math.inf, -math.inf)):
        chunk = with_value(field, row, joint, value)
        with pytest.raises(CommandRefusedError, match=r"^\w+ hold values that are not finite$"):
            check_structure(chunk, RULES)


def test_every_time_must_lie_on_the_grid() -> None:
    for row, off in itertools.product(range(4), (-GRID_NS, -1, 1, GRID_NS)):
        chunk = chunk_of()
        chunk.time_from_start_ns[row] += off
        with pytest.raises(CommandRefusedError) as caught:
            check_structure(chunk, RULES)
        assert str(caught.value) == "points must lie at 0, 1, 2, ... times 4 ms from the stamp"


def test_lateness_is_told_to_the_nanosecond() -> None:
    with pytest.raises(BrokenStreamError, match="stamp is 1e-06 ms in the past"):
        check_time(chunk_of(stamp_ns=NOW * GRID_NS), RULES, NOW * GRID_NS + 1)


def test_every_tick_around_now() -> None:
    """From now to half a second ahead, 125 ticks of 4 ms."""
    for tick in range(NOW - 30, NOW + 160):
        chunk = chunk_of(stamp_ns=tick * GRID_NS)
        if NOW <= tick <= NOW + 125:
            check_time(chunk, RULES, NOW * GRID_NS)
        elif tick < NOW:
            late_ms = 4 * (NOW - tick)
            expected = f"^stamp is {late_ms} ms in the past of the robot server's clock$"
            with pytest.raises(BrokenStreamError, match=expected):
                check_time(chunk, RULES, NOW * GRID_NS)
        else:
            with pytest.raises(CommandRefusedError) as caught:
                check_time(chunk, RULES, NOW * GRID_NS)
            assert type(caught.value) is CommandRefusedError, "not a stream to be taken up again"
            assert str(caught.value) == (
                f"stamp is {4 * (tick - NOW)} ms ahead of the robot server's clock; "
                "at most 500 ms are allowed"
            )


def test_every_stamp_beside_the_grid() -> None:
    for off_ns in (-GRID_NS + 1, -2, -1, 1, 2, 1000, GRID_NS // 2, GRID_NS - 1):
        stamp_ns = (NOW + 5) * GRID_NS + off_ns
        with pytest.raises(CommandRefusedError, match=f"^stamp {stamp_ns} ns is not a multiple"):
            check_time(chunk_of(stamp_ns=stamp_ns), RULES, NOW * GRID_NS)


def test_how_far_ahead_counts_in_nanoseconds() -> None:
    for max_ahead_ns in range(0, 3 * GRID_NS, GRID_NS // 4):
        rules = replace(RULES, max_ahead_ns=max_ahead_ns)
        for ahead in range(4):
            chunk = chunk_of(stamp_ns=(NOW + ahead) * GRID_NS)
            if ahead * GRID_NS <= max_ahead_ns:
                check_time(chunk, rules, NOW * GRID_NS)
            else:
                with pytest.raises(CommandRefusedError, match="ahead"):
                    check_time(chunk, rules, NOW * GRID_NS)


def test_now_may_lie_beside_the_grid() -> None:
    """A robot's cycle may be any: what is due before its next cycle is late."""
    for off_ns in (1, 32_000, GRID_NS // 2, GRID_NS - 1):
        now_ns = NOW * GRID_NS + off_ns
        for tick in range(NOW - 5, NOW + 130):
            chunk = chunk_of(stamp_ns=tick * GRID_NS)
            if NOW < tick <= NOW + 125:
                check_time(chunk, RULES, now_ns)
                continue
            with pytest.raises(CommandRefusedError) as caught:
                check_time(chunk, RULES, now_ns)
            assert isinstance(caught.value, BrokenStreamError) == (tick <= NOW)


def test_half_a_second_ahead_to_the_nanosecond() -> None:
    rules = ValidationRules(NAMES, grid_ns=1)
    for ahead in range(499_999_998, 500_000_003):
        chunk = chunk_of(stamp_ns=NOW + ahead)
        if ahead <= 500_000_000:
            check_time(chunk, rules, NOW)
        else:
            with pytest.raises(CommandRefusedError, match="ahead"):
                check_time(chunk, rules, NOW)


def test_commands_without_a_place_in_the_plan_are_at_most_two_seconds_old() -> None:
    second = 1_000_000_000
    for clock_ns, sign in itertools.product((0, 10**18), (1, -1)):
        for age_ns in (0, 1, second, 2 * second - 1, 2 * second):
            check_fresh(clock_ns - sign * age_ns, clock_ns)
        for age_ns in (2 * second + 1, 3 * second, 10**15):
            with pytest.raises(CommandRefusedError) as caught:
                check_fresh(clock_ns - sign * age_ns, clock_ns)
            assert str(caught.value) == (
                f"the command is {sign * age_ns / 10**9:.6g} s old by the robot server's clock; "
                "at most 2 s are allowed"
            )


@pytest.mark.parametrize(
    ("field", "what", "unit", "tolerance"),
    [
        ("q", "position", "rad", 1e-9),
        ("v", "velocity", "rad/s", 1e-7),
        ("a", "acceleration", "rad/s^2", 1e-5),
    ],
)
def test_splice_tolerances(field: str, what: str, unit: str, tolerance: float) -> None:
    start = chunk_of()
    plan = start.trajectory.point(0)
    for (joint, sign), factor in itertools.product(SIGNED_JOINTS, LADDER):
        chunk = with_value(field, 0, joint, sign * factor * tolerance)
        if factor < 1.0:
            check_splice(chunk, plan, RULES)
            continue
        with pytest.raises(BrokenStreamError) as caught:
            check_splice(chunk, plan, RULES)
        assert str(caught.value) == (
            f"splice: {what} of {NAMES[joint]} steps by {factor * tolerance:.3g} {unit} "
            f"from the robot server's plan (tolerance {tolerance:g})"
        )


def test_a_plan_without_accelerations_is_no_plan() -> None:
    start = chunk_of()
    with pytest.raises(ValueError, match="shorter"):
        check_splice(start, start.trajectory.point(0)[:2], RULES)  # type: ignore[arg-type]


@pytest.mark.parametrize("field", FIELDS)
def test_only_the_first_sample_is_spliced_and_the_worst_joint_named(field: str) -> None:
    start = chunk_of()
    plan = start.trajectory.point(0)
    for row, joint in itertools.product((1, 2, 3), range(3)):
        check_splice(with_value(field, row, joint, 1.0), plan, RULES)
    for joint in range(3):
        chunk = with_value(field, 0, joint, -0.5)
        getattr(chunk.trajectory, field)[0] += 0.01
        with pytest.raises(BrokenStreamError, match=f" of {NAMES[joint]} steps by 0.49 "):
            check_splice(chunk, plan, RULES)


def test_a_step_of_exactly_the_tolerance_is_allowed() -> None:
    rules = replace(RULES, splice_tolerance=(0.5, 0.25, 0.125), rest_tolerance=(0.25, 0.125))
    start = chunk_of()
    plan = start.trajectory.point(0)
    for (joint, sign), field in itertools.product(SIGNED_JOINTS, FIELDS):
        tolerance = {"q": 0.5, "v": 0.25, "a": 0.125}[field]
        check_splice(with_value(field, 0, joint, sign * tolerance), plan, rules)
        check_rest(with_value(field, -1, joint, sign * tolerance), rules)
        with pytest.raises(BrokenStreamError):
            check_splice(with_value(field, 0, joint, sign * (tolerance + 1e-9)), plan, rules)


@pytest.mark.parametrize(("field", "tolerance"), [("v", 1e-6), ("a", 1e-4)])
def test_rest_at_the_end(field: str, tolerance: float) -> None:
    for (joint, sign), factor in itertools.product(SIGNED_JOINTS, LADDER):
        chunk = with_value(field, -1, joint, sign * factor * tolerance)
        if factor < 1.0:
            check_rest(chunk, RULES)
            continue
        with pytest.raises(CommandRefusedError) as caught:
            check_rest(chunk, RULES)
        left = {"v": 0.0, "a": 0.0, field: factor * tolerance}
        assert str(caught.value) == (
            f"a chunk must end at rest; this ends at {left['v']:.3g} rad/s, {left['a']:.3g} rad/s^2"
        )


@pytest.mark.parametrize("field", ["v", "a"])
def test_only_the_last_sample_must_be_at_rest(field: str) -> None:
    for row, joint in itertools.product(range(3), range(3)):
        check_rest(with_value(field, row, joint, 1.0), RULES)
    check_rest(with_value("q", -1, 0, 1.0), RULES)


def test_rules_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        RULES.max_points = 10**9  # type: ignore[misc]


def test_commands_have_at_most_131072_bytes() -> None:
    for size in (0, 1, 100_000, 131_071, 131_072):
        check_size(size)
    for size in (131_073, 131_200, 1_000_000):
        with pytest.raises(CommandRefusedError) as caught:
            check_size(size)
        assert str(caught.value) == f"the command has {size} bytes; at most 131072 are read"


def test_gripper_commands_of_up_to_a_kibibyte_are_read() -> None:
    check_size(1024, MAX_GRIPPER_BYTES)
    with pytest.raises(CommandRefusedError, match="1025 bytes; at most 1024 are read"):
        check_size(1025, MAX_GRIPPER_BYTES)
