"""The control loop: read, decide, write, in every cycle, until the motion or something ends it."""

from __future__ import annotations

import numpy as np
import pytest
from loop_bench import Bench, Q, arm_state

from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.interrupt import StopRequestedError
from skewmi.deploy.session.refused import LateChunkError, ReferenceMovedError
from skewmi.errors import CommandRefusedError, LimitViolationError
from skewmi.trajectory import CYCLE_NS, CYCLE_TICKS, Array, JointTrajectory


class Counted:
    """A motion of so many chunks, which rest."""

    def __init__(self, log: list[str], chunks: int, until_ns: int = 1 << 62) -> None:
        self._log, self._left, self._until_ns = log, chunks, until_ns

    def begin(self, q: Array, state: ArmState) -> None:
        self._log.append("begin")

    def is_over(self, state: ArmState) -> bool:
        return state.stamp_ns >= self._until_ns

    def next_chunk(self, state: ArmState, splice: int) -> JointTrajectory | None:
        self._log.append("decide")
        self._left -= 1
        return None if self._left < 0 else JointTrajectory.resting(Q, CYCLE_TICKS + 1)

    def after_sending(self, state: ArmState) -> None:
        self._log.append("after")


CYCLE = ["scene", "decide", "write", "after", "read", "check, late is final"]


def test_every_cycle_reads_decides_and_writes_in_that_order() -> None:
    bench = Bench()
    state = bench.loop.run(Counted(bench.log, 3), Q, arm_state(0))
    assert bench.log == ["begin", *3 * CYCLE, "scene", "decide"]
    assert state.stamp_ns == bench.status.clock_ns == 3 * CYCLE_NS


def test_a_motion_that_is_over_is_asked_for_nothing() -> None:
    bench = Bench()
    bench.loop.run(Counted(bench.log, 3, until_ns=CYCLE_NS), Q, arm_state(0))
    assert bench.log == ["begin", *CYCLE]


def test_a_lost_state_is_made_up_for_with_two_chunks() -> None:
    bench = Bench([arm_state(1), arm_state(3), arm_state(4)])
    bench.loop.run(Counted(bench.log, 4), Q, arm_state(0))
    traffic = [word for word in bench.log if word in ("read", "write")]
    assert traffic == ["write", "read", "write", "read", "write", "write", "read"]


def test_an_interrupt_ends_the_motion_before_anything_more_is_decided() -> None:
    bench = Bench()
    motion = Counted(bench.log, 3)
    motion.after_sending = lambda state: bench.stop.set()
    with pytest.raises(StopRequestedError, match="interrupted"):
        bench.loop.run(motion, Q, arm_state(0))
    assert bench.log == ["begin", "scene", "decide", "write", "read"]


@pytest.mark.parametrize("lock_step", [True, False])
def test_what_the_robot_says_ends_the_motion(lock_step: bool) -> None:
    bench = Bench(says={2: CommandRefusedError("no")}, lock_step=lock_step)
    with pytest.raises(CommandRefusedError, match="no"):
        bench.loop.run(Counted(bench.log, 9), Q, arm_state(0))
    assert bench.log.count("write") == 2
    assert bench.log[-1] == ("check, late is final" if lock_step else "check")


def test_a_repeated_state_is_a_reason_to_ask_and_nothing_else() -> None:
    bench = Bench([None, None, arm_state(1)], lock_step=False)
    bench.loop.run(Counted(bench.log, 1), Q, arm_state(0))
    ask = ["read", "check, late is final"]
    begin = ["held", "now", "begin"]
    assert bench.log == [*begin, *CYCLE[:4], *ask, *ask, "read", "check", "scene", "decide"]


def test_what_a_check_refuses_is_not_written() -> None:
    def refuse(*args: object) -> None:
        raise LimitViolationError("test", 2.0, 1.0)

    bench = Bench()
    bench.checks.append(("check", refuse))
    with pytest.raises(LimitViolationError):
        bench.loop.run(Counted(bench.log, 3), Q, arm_state(0))
    assert bench.log == ["begin", "scene", "decide"]


def test_recovery_waits_for_rest_and_counts_the_cycle() -> None:
    bench = Bench()
    q, state = bench.loop.recover(LateChunkError("late"))
    np.testing.assert_array_equal(q, Q + 0.001)
    assert state.stamp_ns == arm_state(1000).stamp_ns
    assert bench.stream.missed_cycles == 1
    bench.loop.recover(ReferenceMovedError("moved"))
    assert bench.stream.missed_cycles == 1, "nothing was late"
    bench.stop.set()
    with pytest.raises(StopRequestedError):
        bench.loop.recover(LateChunkError("late"))
