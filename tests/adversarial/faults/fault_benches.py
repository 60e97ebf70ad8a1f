"""Benches that are started when needed, and cells run on them."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

from fault_bench import Bench
from fault_cell import ATTEMPTS, BUSY, Fault, NotReachedError, Observed, Phase, run_cell
from fault_clock import WallClock

from skewmi.deploy.wire import topics


def bench_of(fault: Fault) -> str:
    """Name of the bench that a fault needs: pace, clock and robot."""
    name = "clock" if fault.clock_jump_s else "lock-step" if fault.lock_step else "real time"
    return name + (", EGM" if fault.egm else "")


class Benches:
    """One bench at a time, of the pace and with the clock that a cell needs.

    Args:
        folder: For logs.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._bench: Bench | None = None
        self._name = ""
        self._count = 0

    def close(self) -> None:
        """End the present bench."""
        if self._bench is not None:
            self._bench.__exit__()
            self._bench = None

    def observe(self, fault: Fault, phase: Phase, expected: Callable[[Observed], bool]) -> Observed:
        """Run a cell; again if it went otherwise than expected because the machine was busy.

        Raises:
            AssertionError: The arm was not safe, or a wall clock did not jump.
            NotReachedError: The machine is too busy.
            RuntimeError: There is no C compiler for the wall clock.
        """
        for attempt in range(ATTEMPTS):
            bench = self._fitting(fault)
            try:
                observed = run_cell(fault, phase, bench)
                busy = any(reason in observed.said for reason in BUSY)
                if expected(observed) or not busy:
                    break
            except NotReachedError:
                if attempt == ATTEMPTS - 1:
                    raise
            except BaseException:
                self.close()  # whatever state it is in
                raise
            finally:
                if bench.clock is not None:
                    bench.clock.jump(0)
        if fault.clock_jump_s:
            for topic in (topics.YUMI_TRAJECTORY, topics.YUMI_JOINT_STATES):
                assert_jumped(observed.times[topic.name], fault.clock_jump_s, phase)
        return observed

    def _fitting(self, fault: Fault) -> Bench:
        name = bench_of(fault)
        if self._bench is None or name != self._name:
            self.close()
            self._count += 1
            folder = self._folder / str(self._count)
            folder.mkdir()
            clock = WallClock(folder) if fault.clock_jump_s else None
            self._bench = Bench(folder, lock_step=fault.lock_step, clock=clock, egm=fault.egm)
            self._bench.__enter__()
            self._name = name
        return self._bench


def assert_jumped(times: list[tuple[int, int]], offset_s: int, phase: Phase) -> None:
    """The sender's wall clock jumped against our monotonic one, once, by the offset.

    Steps of seconds are the machine's: its own clock being set, or messages that came late.
    """
    offsets = [(wall - ours) / 1e9 for ours, wall in times]
    steps = [after - before for before, after in pairwise(offsets)]
    jumps = [step for step in steps if abs(step) > 60.0]
    if phase is Phase.STOPPING and not jumps:
        return  # nothing was sent after the stop
    assert len(jumps) == 1, jumps
    assert abs(jumps[0] - offset_s) < 60.0, jumps
