"""A guarded motion stops where something is met, holds still to be measured, and always rests."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from loop_bench import Bench, arm_state

from skewmi.deploy.motion.joint_path import JointPath
from skewmi.deploy.motion.path_motion import PathMotion
from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.guarded_motion import (
    LONGEST_HOLD_NS,
    MEASURED_NS,
    REST_NS,
    GuardedMotion,
    HoldStill,
    is_still,
)
from skewmi.errors import LimitViolationError
from skewmi.policy_io import Array
from skewmi.robot_models import limits, yumi
from skewmi.trajectory import CYCLE_NS, CYCLE_TICKS, GRID_S, JointPoint, JointTrajectory

Q = np.array(yumi.TABLE_CONFIGURATION)
PATH = JointPath.line(Q, Q + 0.1)
DIRECTION = np.array([1.0, 0.0, 0.0])


class Watch:
    """Says what a test wants, and keeps what it is told."""

    def __init__(self, touches_at: int = -1, force: float = 0.0) -> None:
        self.touched, self.force = False, 0.0
        self.began: tuple[Array, Array] | None = None
        self.heard: list[Array] = []
        self._touches_at, self._force = touches_at, force

    def begin(self, q: Array, commanded: Array, direction: Array) -> None:
        self.began = (q, commanded)
        self.touched, self.force, self.heard = False, 0.0, []
        np.testing.assert_array_equal(direction, DIRECTION)

    def look(self, commands: JointTrajectory, q: Array) -> None:
        self.heard.append(commands.q)
        if len(self.heard) == self._touches_at:
            self.touched, self.force = True, self._force


class Recorder:
    """What was sent, as a robot server would follow it; the arm measures its command."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        bench.checks.append(("all", self.check))
        self.chunks: list[JointTrajectory] = []

    def check(self, samples: JointTrajectory, previous: JointPoint, earlier: Array) -> None:
        del earlier
        # Each goes on from where the one before is, and ends at rest.
        np.testing.assert_allclose(samples.q[0], previous.q, atol=1e-12)
        np.testing.assert_allclose(samples.v[0], previous.v, atol=1e-12)
        assert not samples.v[-1].any()
        assert not samples.a[-1].any()
        self.chunks.append(samples)

    def states(self) -> Iterator[ArmState]:
        cycle = 0
        while True:
            cycle += 1
            yield arm_state(cycle, self.bench.stream.commanded(cycle * CYCLE_NS))


def run(watch: Watch, force_limit: float = 10.0) -> tuple[GuardedMotion, Recorder]:
    states: list[Iterator[ArmState]] = []
    bench = Bench(iter(lambda: next(states[0]), None))
    recorder = Recorder(bench)
    states.append(recorder.states())
    profile = limits.profile("lab")
    motion = PathMotion(PATH.motion(0.0, 1.0, profile, 0.02), profile)
    guarded = GuardedMotion(motion, DIRECTION, watch, bench.stream, force_limit)
    bench.loop.run(guarded, Q, arm_state(0, Q))
    return guarded, recorder


@pytest.mark.parametrize("touches_at", [1, 2, 17, 60])
def test_it_stops_on_the_path_and_is_measured_at_rest(touches_at: int) -> None:
    watch = Watch(touches_at, 3.0)
    guarded, recorder = run(watch)
    assert guarded.touched
    assert guarded.peak_force == 3.0
    assert watch.began is not None
    np.testing.assert_allclose(watch.began[0], Q, atol=1e-12)
    # Every command of the way is told once, in order: they are those of the chunks.
    heard = np.concatenate(watch.heard)
    assert np.abs(np.diff(heard, axis=0)).max() < 0.1 * GRID_S * 3.0
    rest = recorder.chunks[-1].q[-1]
    np.testing.assert_allclose(PATH.at(PATH.nearest(rest)), rest, atol=1e-6)
    assert 0.0 <= PATH.nearest(rest) < 1.0
    stopped = guarded.held[0].stamp_ns
    assert stopped >= REST_NS + touches_at * CYCLE_NS
    assert guarded.held[-1].stamp_ns - stopped >= MEASURED_NS - CYCLE_NS
    for state in guarded.held:
        np.testing.assert_array_equal(state.q, rest)


def test_without_contact_it_goes_to_the_end_and_says_so() -> None:
    guarded, recorder = run(Watch())
    assert not guarded.touched
    assert not guarded.late
    np.testing.assert_allclose(recorder.chunks[-1].q[-1], PATH.at(1.0), atol=1e-12)
    assert guarded.held


def test_too_much_force_ends_it_with_a_stop_sent_before() -> None:
    watch = Watch(9, 10.5)
    with pytest.raises(LimitViolationError, match="force of the finger tips"):
        run(watch)
    assert run(Watch(9, 9.9))[0].peak_force == 9.9


@pytest.mark.parametrize(("force", "touches"), [(0.0, False), (4.0, True), (10.5, True)])
def test_a_chunk_that_would_be_late_stops_the_arm_under_watch(force: float, touches: bool) -> None:
    """The watch hears of every command of the stop, and what it says still counts."""
    bench = Bench()
    profile = limits.profile("lab")
    motion = PathMotion(PATH.motion(0.0, 1.0, profile, 0.02), profile)
    watch = Watch(8 if touches else -1, force)
    guarded = GuardedMotion(motion, DIRECTION, watch, bench.stream, 10.0, peak_force=1.0)
    guarded.begin(Q, arm_state(0, Q))
    bench.stream.begin(Q, 0)
    state = arm_state(0, Q)
    for cycle in range(16):
        state = arm_state(cycle, Q)
        assert not guarded.is_over(state)
        for splice in bench.stream.due(state.stamp_ns, 0):
            chunk = guarded.next_chunk(state, splice)
            assert chunk is not None
            bench.stream.send(chunk)
    sent = bench.stream.sent
    assert sent is not None
    heard = len(watch.heard)
    bench.stream._next_ns += CYCLE_NS
    chunk = guarded.next_chunk(state, 2 * CYCLE_TICKS)
    assert guarded.late
    assert chunk is not None
    np.testing.assert_array_equal(chunk.q[0], sent.trajectory.q[2 * CYCLE_TICKS])
    np.testing.assert_array_equal(chunk.q[-1], sent.trajectory.q[-1])
    bench.stream.send(chunk)
    assert heard < 8, "nothing is met before the stop"

    def rest() -> None:
        for cycle in range(16, 200):
            at = bench.stream.commanded(cycle * CYCLE_NS)
            if guarded.is_over(arm_state(cycle, at)):
                return
            for splice in bench.stream.due(cycle * CYCLE_NS, 0):
                following = guarded.next_chunk(arm_state(cycle, at), splice)
                assert following is not None
                bench.stream.send(following)
        pytest.fail("it never rests")

    if force > 10.0:
        with pytest.raises(LimitViolationError, match="force of the finger tips"):
            rest()
        return
    rest()
    commands = np.concatenate(watch.heard)
    assert np.abs(np.diff(commands, axis=0)).max() < 0.1 * GRID_S * 3.0, "none is left out"
    np.testing.assert_array_equal(commands[-1], sent.trajectory.q[-1])
    assert guarded.touched is touches
    assert guarded.peak_force == max(force, 1.0)
    assert guarded.held


def test_an_arm_that_never_rests_is_not_waited_for_for_ever() -> None:
    rng = np.random.default_rng(0)
    cycles = iter(range(1, 10_000))

    def state() -> ArmState:
        cycle = next(cycles)
        return arm_state(cycle, Q + 0.01 * np.sin(0.11 * cycle) + 1e-4 * rng.normal(size=7))

    bench = Bench(iter(state, None))
    profile = limits.profile("lab")
    motion = PathMotion(PATH.motion(0.0, 1.0, profile, 0.5), profile)
    guarded = GuardedMotion(motion, DIRECTION, Watch(3), bench.stream, 10.0)
    end = bench.loop.run(guarded, Q, arm_state(0, Q))
    assert end.stamp_ns < REST_NS + LONGEST_HOLD_NS + 2_000_000_000


def test_stillness_is_judged_beyond_noise() -> None:
    rng = np.random.default_rng(1)
    noise = 1e-4 * rng.normal(size=(20, 7))
    assert is_still(noise)
    drift = np.linspace(0.0, 1.2e-3, 20)[:, None] * np.eye(7)[2]
    assert not is_still(noise + drift)
    assert not is_still(noise[:3])


def test_it_holds_still_for_as_long_as_it_is_told() -> None:
    bench = Bench()
    hold = HoldStill(bench.stream, 10 * CYCLE_NS)
    assert bench.loop.run(hold, Q, arm_state(0, Q)).stamp_ns == 10 * CYCLE_NS
    assert bench.log.count("write") == 10
    assert len(hold.states) == 11
