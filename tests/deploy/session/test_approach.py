"""The way to the start: it ends at rest there, or is begun again, so many times."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from loop_bench import Bench, Q, arm_state

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.session.approach import REACHED, START_ATTEMPTS, Approach
from skewmi.deploy.session.refused import LateChunkError
from skewmi.errors import CommandRefusedError
from skewmi.robot_models import limits as joint_limits
from skewmi.trajectory import CYCLE_NS, CYCLE_TICKS, Array

GOAL = Q + 0.2
LAB = joint_limits.profile("lab")


def approach(bench: Bench) -> Approach:
    return Approach(bench.loop, bench.stream, LAB)


def test_it_ends_when_the_arm_rests_at_the_start() -> None:
    bench = Bench(arm_state(n, GOAL) for n in range(1, 100))
    state = approach(bench).run(GOAL, Q, arm_state(0))
    assert bench.stream.sent is not None
    np.testing.assert_array_equal(bench.stream.sent.trajectory.q[-1], GOAL)
    assert bench.log.count("write") >= 5, "it was already there"
    assert bench.log[-2:] == ["read", "check, late is final"]
    # What is sent while the arm comes to rest repeats the goal.
    assert state.stamp_ns < bench.stream.sent.stamp_ns


def test_an_arm_that_is_elsewhere_is_said_to_be() -> None:
    bench = Bench(arm_state(n, GOAL + 1.01 * REACHED) for n in range(1, 100))
    with pytest.raises(CommandRefusedError, match="from the start configuration"):
        approach(bench).run(GOAL, Q, arm_state(0))


def test_after_a_late_chunk_it_is_begun_again_but_not_for_ever() -> None:
    late, tries = LateChunkError("late"), START_ATTEMPTS - 1
    cycles = [*range(1, tries + 1), *range(1001, 1200)]
    says = dict.fromkeys(range(1, tries + 1), late)
    bench = Bench((arm_state(n, GOAL) for n in cycles), says)
    approach(bench).run(GOAL, Q, arm_state(0))
    assert bench.log.count("hold") == bench.stream.missed_cycles == tries

    bench = Bench(says=dict.fromkeys(range(1, START_ATTEMPTS + 1), late))
    with pytest.raises(CommandRefusedError, match="came too late"):
        approach(bench).run(GOAL, Q, arm_state(0))
    assert bench.log.count("hold") == START_ATTEMPTS


def test_lateness_while_the_arm_comes_to_rest_begins_nothing_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A soft arm arrives after its last command; what is sent then only rests."""
    sent = StartMotion(Q, GOAL, LAB).cycles
    late_ns = (sent + 5) * CYCLE_NS
    behind = GOAL - 2 * REACHED
    bench = Bench(arm_state(n, GOAL if n > sent + 8 else behind) for n in range(1, 300))
    stream, starts = bench.stream, []
    due, begin = stream.due, stream.begin

    def late_once(stamp_ns: int, received_ns: int) -> Iterator[int]:
        for splice in due(stamp_ns, received_ns):
            if stamp_ns == late_ns:
                assert stream.sent is not None
                np.testing.assert_array_equal(stream.sent.trajectory.q - GOAL, 0.0)
                stream._next_ns += CYCLE_NS
                splice += CYCLE_TICKS
            yield splice

    def noted(q: Array, stamp_ns: int) -> None:
        starts.append(q)
        begin(q, stamp_ns)

    monkeypatch.setattr(stream, "due", late_once)
    monkeypatch.setattr(stream, "begin", noted)
    approach(bench).run(GOAL, Q, arm_state(0))
    assert len(starts) == 1
    assert stream.sent is not None
    assert stream.sent.stamp_ns > late_ns, "it was late"


def test_a_way_that_cannot_be_taken_up_is_followed_to_rest_and_begun_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As in real time, when planning was held up for a cycle."""
    bench = Bench(arm_state(n, GOAL) for n in range(1, 200))
    stream, starts = bench.stream, []
    due, begin = stream.due, stream.begin

    def late_once(stamp_ns: int, received_ns: int) -> Iterator[int]:
        for splice in due(stamp_ns, received_ns):
            yield splice + (CYCLE_TICKS if stamp_ns == 2 * CYCLE_NS else 0)

    def noted(q: Array, stamp_ns: int) -> None:
        starts.append(q)
        begin(q, stamp_ns)

    monkeypatch.setattr(stream, "due", late_once)
    monkeypatch.setattr(stream, "begin", noted)
    approach(bench).run(GOAL, Q, arm_state(0))
    first, second = starts
    np.testing.assert_array_equal(first, Q)
    assert (second > Q).all(), "it had begun to move"
    assert (second < GOAL).all(), "it came to rest on the way"
    assert "hold" not in bench.log, "nothing was refused"
