"""The plan, and where a stop ends it: nothing that was executed is forgotten."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.robot.executor import REMEMBERED, PlanExecutor
from skewmi.policy_io import Array
from skewmi.trajectory import GRID_NS, JointTrajectory

FIRST = 20
"""Tick of the first sample of plans here."""


def plan_of(*positions: float, joints: int = 2) -> PlanExecutor:
    """A plan through positions of the last joint, from 0 on; at rest wherever it stays."""
    q = np.zeros((len(positions), joints))
    q[:, -1] = positions
    moves = np.diff(q, axis=0, prepend=0.0) != 0.0
    plan = PlanExecutor(np.zeros(joints), (FIRST - 10) * GRID_NS)
    plan.splice(FIRST * GRID_NS, JointTrajectory(q, 1.0 * moves, 1.0 * moves), FIRST * GRID_NS)
    return plan


def positions(plan: PlanExecutor, begin: int, end: int) -> Array:
    """Of the last joint at each tick."""
    return np.array([plan.at(tick * GRID_NS).q[-1] for tick in range(begin, end)])


@pytest.mark.parametrize("executed", range(FIRST - 5, FIRST + 12))
def test_a_stop_ends_the_plan_where_it_first_rests(executed: int) -> None:
    # Rests, moves, stands for one and for two samples, rests, and moves again.
    path = (0.0, 0.0, 0.1, 0.1, 0.2, 0.2, 0.2, 0.2, 0.3, 0.4, 0.4)
    plan, whole = plan_of(*path), plan_of(*path)
    plan.end_at_rest(executed * GRID_NS)
    if executed <= FIRST + 1:
        end = max(executed, FIRST - REMEMBERED)
    elif executed <= FIRST + 7:
        end = max(executed, FIRST + 6)
    else:
        end = FIRST + 10  # never more than it was
    assert plan.end_ns == end * GRID_NS
    # Up to there it is what it was, before it is executed and after.
    for tick in range(FIRST - REMEMBERED, end + 1):
        assert plan.at(tick * GRID_NS).q[-1] == whole.at(tick * GRID_NS).q[-1]
        assert np.array_equal(plan.at(tick * GRID_NS).v, whole.at(tick * GRID_NS).v)
    assert np.ptp(positions(plan, end, end + 30)) == 0.0
    assert plan.at_rest(end * GRID_NS)


@pytest.mark.parametrize("field", ["v", "a"])
@pytest.mark.parametrize("joint", [0, 1])
def test_what_has_velocity_or_acceleration_does_not_rest(field: str, joint: int) -> None:
    rows = {name: np.zeros((8, 2)) for name in ("q", "v", "a")}
    rows["q"][-1] = 0.1
    rows[field][:6, joint] = 1e-12
    plan = PlanExecutor(np.zeros(2), FIRST * GRID_NS)
    plan.splice(FIRST * GRID_NS, JointTrajectory(**rows), FIRST * GRID_NS)
    plan.end_at_rest(FIRST * GRID_NS)
    assert plan.end_ns == (FIRST + 6) * GRID_NS


@pytest.mark.parametrize("joint", [0, 1])
def test_all_joints_must_rest(joint: int) -> None:
    q = np.zeros((8, 2))
    q[:4, joint] = (0.1, 0.2, 0.3, 0.4)
    q[4:, joint] = 0.4
    q[6:, 1 - joint] = 0.1
    plan = PlanExecutor(np.zeros(2), FIRST * GRID_NS)
    plan.splice(FIRST * GRID_NS, JointTrajectory(q, 0 * q, 0 * q), FIRST * GRID_NS)
    plan.end_at_rest(FIRST * GRID_NS)
    assert plan.end_ns == (FIRST + 5) * GRID_NS


@pytest.mark.parametrize("off_ns", [1, GRID_NS // 2, GRID_NS - 1])
def test_between_two_samples_the_motion_to_the_next_has_begun(off_ns: int) -> None:
    """A robot's cycle may be any."""
    plan = plan_of(0.0, 0.0, 0.0, 0.1, 0.2, 0.2, 0.2)
    plan.end_at_rest((FIRST + 1) * GRID_NS + off_ns)
    assert plan.end_ns == (FIRST + 2) * GRID_NS
    plan = plan_of(0.0, 0.0, 0.0, 0.1, 0.2, 0.2, 0.2)
    plan.end_at_rest((FIRST + 2) * GRID_NS + off_ns)
    assert plan.end_ns == (FIRST + 6) * GRID_NS


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 12), st.booleans()), max_size=12), st.integers(0, 2**32))
def test_stops_and_chunks_leave_no_gap_in_what_is_remembered(
    events: list[tuple[int, bool]], seed: int
) -> None:
    """However chunks and stops follow one another: every third difference of what is executed is
    zero, or one of a stream that was judged: the motion before a chunk, the chunk, and rest."""
    rng = np.random.default_rng(seed)
    tick, plan = 7, PlanExecutor(np.zeros(1), 6 * GRID_NS)
    executed = [0.0] * REMEMBERED
    judged: set[tuple[float, ...]] = set()
    for ticks, stopped in events:
        if stopped:
            plan.end_at_rest((tick - 1) * GRID_NS)
        else:
            stamp_ns = (tick + int(rng.integers(0, 8))) * GRID_NS
            # Whole numbers, few of them: differences are exact, and rests are frequent.
            q = rng.integers(0, 3, (int(rng.integers(2, 12)), 1)).astype(float)
            earlier = plan.before(stamp_ns)
            plan.splice(stamp_ns, JointTrajectory(q, 0 * q, 0 * q), tick * GRID_NS)
            stream = np.concatenate((earlier, q, q[[-1] * 3]))[:, 0]
            judged |= {tuple(stream[k : k + 4]) for k in range(len(stream) - 3)}
        for _ in range(ticks):
            assert plan.before(tick * GRID_NS)[:, 0].tolist() == executed[-REMEMBERED:]
            executed.append(float(plan.at(tick * GRID_NS).q[0]))
            tick += 1
    for k in range(len(executed) - 3):
        window = tuple(executed[k : k + 4])
        assert window in judged or len(set(window)) == 1


@given(ends=st.lists(st.tuples(st.integers(0, 20), st.integers(2, 30)), max_size=8))
def test_plan_is_the_newest_chunk_at_every_tick(ends: list[tuple[int, int]]) -> None:
    plan, now = PlanExecutor(np.zeros(1), 0), 0
    expected: dict[int, float] = {}
    last = 0.0
    for number, (ahead, length) in enumerate(ends, start=1):
        now += 3
        tick = now + ahead
        q = np.full((length, 1), float(number))
        plan.splice(tick * GRID_NS, JointTrajectory(q, q, q), now * GRID_NS)
        for t in range(now, now + 100):
            if t >= tick:
                expected[t] = float(number)
        last = float(number)
    for t in range(now, now + 60):
        at_tick = plan.at(t * GRID_NS).q[0]
        assert at_tick == expected.get(t, 0.0 if not ends else expected.get(t, 0.0))
    assert plan.at(plan.end_ns + 1000 * GRID_NS).q[0] == last
    assert plan.at_rest(plan.end_ns)
    assert not plan.at_rest(plan.end_ns - 1)
