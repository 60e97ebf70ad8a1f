"""Differences of positions over the ends of chunks: what a servo sees where motions meet.

Linear programming finds the chunks that use every freedom which the checks of a single chunk leave,
to break acceleration or jerk over an end. In units of J h^3, J h^2, J h every check is linear.
(Acceleration next to rest cannot be broken so: jerk is, long before.)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.executor import REMEMBERED, PlanExecutor
from skewmi.deploy.safety.limits import GRID_DT, ChunkChecker
from skewmi.errors import LimitViolationError
from skewmi.policy_io import Array
from skewmi.robot_models import limits
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import GRID_NS, JointTrajectory

LAB = limits.profile("lab")
CHECKER = ChunkChecker(LAB)
MIDDLE = (LAB.position_lower + LAB.position_upper) / 2.0
JOINT, N, SPLICE = 6, 40, 15
SCALE = LAB.jerk[JOINT] * GRID_DT ** np.array([3, 2, 1]) * (1 - 1e-5)
"""Units of q, v, a."""
A_BOUND = LAB.acceleration[JOINT] / (LAB.jerk[JOINT] * GRID_DT)
V_BOUND = LAB.velocity[JOINT] / (LAB.jerk[JOINT] * GRID_DT**2)


class Program:
    """Rows of a linear program over two chunks of N samples: q, v, a of each."""

    def __init__(self) -> None:
        self.upper: list[Array] = []
        self.bounds: list[float] = []
        self.equal: list[Array] = []

    def at(self, chunk: int, which: int, k: int) -> Array:
        row = np.zeros(6 * N)
        row[(3 * chunk + which) * N + k] = 1.0
        return row

    def bound(self, row: Array, bound: float) -> None:
        self.upper += [row, -row]
        self.bounds += [bound, bound]

    def inside(self, chunk: int) -> None:
        """What is demanded of a chunk on its own."""
        q, v, a = ([self.at(chunk, which, k) for k in range(N)] for which in range(3))
        for k in range(N):
            self.bound(v[k], V_BOUND)
            self.bound(a[k], A_BOUND)
        for order, series, limit in (
            (1, q, V_BOUND), (2, q, A_BOUND), (3, q, 1.0),
            (1, v, A_BOUND), (2, v, 1.0), (1, a, 1.0),
        ):  # fmt: skip
            for row in np.diff(series, n=order, axis=0):
                self.bound(row, limit)
        for k in range(N - 1):
            for x, y, back in ((k, k + 1, 1.0), (k + 1, k, -1.0)):
                self.bound(v[y] - v[x] - back * a[x], 0.5)
                self.bound(q[y] - q[x] - back * v[x] - a[x] / 2, 1.0 / 6.0)
        self.equal += [v[-1], a[-1]]

    def largest(self, row: Array) -> tuple[float, Array]:
        """The largest value of a row, and (q, v, a) of both chunks in rad and s. (2, 3, N)."""
        found = linprog(
            -row,
            A_ub=np.array(self.upper),
            b_ub=self.bounds,
            A_eq=np.array(self.equal),
            b_eq=np.zeros(len(self.equal)),
            bounds=(None, None),
        )
        assert found.status == 0
        return -found.fun, found.x.reshape(2, 3, N) * SCALE[:, None]


def worst(where: str, order: int) -> tuple[float, list[tuple[Array, Array, Array]]]:
    """Two chunks, the second spliced into the first, that break a difference as much as can be.

    Args:
        where: Over the start of the first, the splice, or the end of the second.
        order: 2 for acceleration, 3 for jerk.

    Returns:
        The difference as a share of its bound, and the chunks, each (q, v, a) of shape (N, 7).
    """
    program = Program()
    for chunk in range(2):
        program.inside(chunk)
    at = program.at
    program.equal += [at(0, which, 0) for which in range(3)]
    program.equal += [at(1, which, 0) - at(0, which, SPLICE) for which in range(3)]
    series = {
        "start": [at(0, 0, 0)] * 3 + [at(0, 0, 1), at(0, 0, 2)],
        "splice": [at(0, 0, SPLICE + k) for k in (-2, -1, 0)] + [at(1, 0, 1), at(1, 0, 2)],
        "end": [at(1, 0, N - 3), at(1, 0, N - 2)] + [at(1, 0, N - 1)] * 3,
    }[where]
    rows = np.diff(series, n=order, axis=0)
    share, values = max((program.largest(row) for row in rows), key=lambda found: found[0])
    chunks = []
    for q, v, a in values:
        full = np.zeros((3, N, 7))
        full[:, :, JOINT] = q, v, a
        full[0] += MIDDLE
        full[1:, -1] = 0.0
        chunks.append(tuple(full))
    return share / (A_BOUND if order == 2 else 1.0), chunks


@pytest.mark.parametrize(
    ("where", "order"), [("start", 3), ("splice", 2), ("splice", 3), ("end", 3)]
)
def test_whoever_uses_the_freedom_at_an_end_is_refused(where: str, order: int) -> None:
    share, chunks = worst(where, order)
    assert share > 1.03, "there is no freedom to use"
    for scale, accepted in ((1.0, False), (1.01 / share, False), (0.99 / share, True)):
        if accepted and order == 2:
            continue  # jerk is broken, too
        first, second = ([part * scale for part in chunk] for chunk in chunks)
        for chunk in (first, second):
            chunk[0] += (1.0 - scale) * MIDDLE
        if accepted:
            follow(first, second)
        else:
            with pytest.raises(LimitViolationError, match="over an end"):
                follow(first, second)


def follow(first: list[Array], second: list[Array]) -> None:
    """Judge a chunk from rest, and one that is spliced into it, as a robot server does."""
    now_ns = 10 * GRID_NS
    plan = PlanExecutor(MIDDLE, now_ns)
    rest = MIDDLE, np.zeros(7), np.zeros(7)
    CHECKER.check(*first, previous=rest, earlier=plan.before(now_ns))
    plan.splice(now_ns, JointTrajectory(*first), now_ns)
    splice_ns = now_ns + SPLICE * GRID_NS
    at_splice = plan.at(splice_ns)
    for part, value in zip(second, at_splice, strict=True):
        part[0] = value
    CHECKER.check(*second, previous=at_splice, earlier=plan.before(splice_ns))


def test_without_a_motion_in_progress_there_was_rest() -> None:
    share, (chunk, _) = worst("start", 3)
    for scale, accepted in ((1.01 / share, False), (0.99 / share, True)):
        q, v, a = (part * scale for part in chunk)
        q += (1.0 - scale) * MIDDLE
        if accepted:
            CHECKER.check(q, v, a)
        else:
            with pytest.raises(LimitViolationError, match="jerk over an end"):
                CHECKER.check(q, v, a)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 400), st.floats(0.01, 0.5))
def test_samples_of_one_motion_pass_wherever_they_are_spliced(
    seed: int, splice: int, size: float
) -> None:
    """Whatever the grid cuts out of a motion that keeps the limits keeps them over the ends."""
    rng = np.random.default_rng(seed)
    motion = StartMotion(MIDDLE, MIDDLE + size * rng.uniform(-1.0, 1.0, 7), LAB).trajectory
    splice = min(splice, len(motion.q) - 2)
    plan = PlanExecutor(MIDDLE, 5 * GRID_NS)
    plan.splice(5 * GRID_NS, motion, 5 * GRID_NS)
    rest = (x[splice:] for x in (motion.q, motion.v, motion.a))
    now_ns = (5 + splice) * GRID_NS
    CHECKER.check(*rest, previous=plan.at(now_ns), earlier=plan.before(now_ns))


@given(st.lists(st.integers(0, 30), min_size=1, max_size=8), st.integers(0, 2**32 - 1))
def test_the_plan_remembers_what_was_executed(gaps: list[int], seed: int) -> None:
    """However chunks are laid over one another: three samples back, at any tick still to come."""
    rng = np.random.default_rng(seed)
    tick, plan = 7, PlanExecutor(np.zeros(7), 7 * GRID_NS)
    executed = {k: np.zeros(7) for k in range(7 - REMEMBERED, 7)}
    for gap in gaps:
        q = rng.normal(size=(rng.integers(2, 40), 7))
        stamp_ns = (tick + int(rng.integers(0, 20))) * GRID_NS
        plan.splice(stamp_ns, JointTrajectory(q, q, q), tick * GRID_NS)
        for _ in range(gap):
            executed[tick] = plan.at(tick * GRID_NS).q
            tick += 1
        np.testing.assert_array_equal(
            plan.before(tick * GRID_NS), [executed[tick - age] for age in (3, 2, 1)]
        )


def test_what_was_commanded_before_must_be_numbers() -> None:
    still = np.tile(MIDDLE, (4, 1)), np.zeros((4, 7)), np.zeros((4, 7))
    rest = MIDDLE, np.zeros(7), np.zeros(7)
    earlier = np.tile(MIDDLE, (3, 1))
    CHECKER.check(*still, previous=rest, earlier=earlier)
    for value in (np.nan, np.inf):
        earlier[1, 2] = value
        with pytest.raises(LimitViolationError, match=r"finite numbers.*earlier motion") as caught:
            CHECKER.check(*still, previous=rest, earlier=earlier)
        assert caught.value.bound == 0.0


WIDE = {"acceleration": np.full(7, 1e4), "jerk": np.full(7, 1e9)}
OVER_AN_END: dict[str, tuple[float, float, tuple[float, ...], JointLimits]] = {
    "velocity": (GRID_DT, 2e-12, (1.0, 1.0, 1.0), replace(LAB, **WIDE)),
    "acceleration": (GRID_DT**2, 4e-12, (1.0, 2.0, 2.0), replace(LAB, jerk=WIDE["jerk"])),
    "jerk": (GRID_DT**3, 8e-12, (1.0, 3.0, 3.0), LAB),
}
"""Of each order of difference: its factor, the room for rounding, the largest binomial coefficient
that each sample before the chunk meets, and limits of which its own is broken first."""


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("of", OVER_AN_END)
@pytest.mark.parametrize("sample", range(3))
def test_bounds_over_an_end_are_sharp(of: str, joint: int, sign: float, sample: int) -> None:
    """One sample before a resting chunk lies off, as far as the bound allows, and a bit more."""
    factor, room, times, bounds = OVER_AN_END[of]
    checker = ChunkChecker(bounds)
    still = np.tile(MIDDLE, (4, 1)), np.zeros((4, 7)), np.zeros((4, 7))
    rest = MIDDLE, np.zeros(7), np.zeros(7)
    bound = (getattr(LAB, of)[joint] * factor + room) / times[sample]
    earlier = np.tile(MIDDLE, (3, 1))
    earlier[sample, joint] += sign * bound * (1 - 1e-6)
    checker.check(*still, previous=rest, earlier=earlier)
    earlier[sample, joint] += sign * bound * 3e-6
    with pytest.raises(LimitViolationError, match=f"{of} over an end.*joint index {joint}"):
        checker.check(*still, previous=rest, earlier=earlier)


@pytest.mark.parametrize("of", OVER_AN_END)
def test_rounding_of_positions_breaks_no_small_bound(of: str) -> None:
    _, room, _, bounds = OVER_AN_END[of]
    checker = ChunkChecker(replace(bounds, **{of: np.full(7, 1e-12)}))
    still = np.tile(MIDDLE, (4, 1)), np.zeros((4, 7)), np.zeros((4, 7))
    rest = MIDDLE, np.zeros(7), np.zeros(7)
    for factor, accepted in ((0.97, True), (1.06, False)):
        earlier = np.tile(MIDDLE, (3, 1))
        earlier[0, 3] += factor * room
        if accepted:
            checker.check(*still, previous=rest, earlier=earlier)
        else:
            with pytest.raises(LimitViolationError, match=f"{of} over an end"):
                checker.check(*still, previous=rest, earlier=earlier)
