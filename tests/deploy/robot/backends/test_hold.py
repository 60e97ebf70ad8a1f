"""The robot that holds its command, and what it proves: any cycle, no scene, a robot not ready."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lone_robot import LoneRobot

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.backends import BACKENDS, BackendOptions, make_backend
from skewmi.deploy.robot.backends.hold import HoldBackend
from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi
from skewmi.trajectory import CYCLE_NS, GRID_NS, JointPoint

LAB = joint_limits.profile("lab")
HOME = np.array(yumi.HOME["right"])
AWAY = HOME + np.linspace(0.3, -0.3, 7)
OURS = b"a" * 16


def holding(period_ns: int = GRID_NS, delay_s: float = 0.0) -> HoldBackend:
    return HoldBackend(HOME, delay_s=delay_s, lock_step=True, period_ns=period_ns)


def test_waiting_in_lock_step_takes_no_memory() -> None:
    robot = holding(delay_s=0.1)
    robot.open(lambda: False)
    assert robot.read() is not None
    for _ in range(50):
        # Time stands still: the same cycle is answered again.
        robot.write(JointPoint(AWAY, np.zeros(7), np.zeros(7)))
    assert len(robot._underway) == 1


# The clock is the robot's.


@pytest.mark.parametrize("period_ns", [4_000_000, 4_032_000, 3_968_000, 8_064_000])
def test_a_plan_is_followed_in_true_time_whatever_the_cycle(period_ns: int) -> None:
    """Streamed as a session does: the robot gets the motion itself, at its own times."""
    robot = LoneRobot(holding(period_ns), LAB)
    motion = StartMotion(HOME, AWAY, LAB)
    robot.requests.arm(OURS, 0)
    begin_ns = 5 * CYCLE_NS
    times_ns, sent = [], 0
    while robot.controller.clock_ns < begin_ns + round(1e9 * motion.trajectory.duration_s):
        # Some 24 ms before each chunk is due, as the states of the newest cycle arrive.
        if sent < motion.cycles and robot.controller.clock_ns >= begin_ns + (sent - 1) * CYCLE_NS:
            tick = (begin_ns + sent * CYCLE_NS) // GRID_NS
            payload = robot.payload(motion.chunk(sent), tick)
            assert robot.controller.receive(payload, OURS, sent + 1, 0), robot.refusals()
            sent += 1
        robot.run(1)
        times_ns.append(robot.controller.arm_motion.executed_ns)
    assert sent == motion.cycles
    targets = robot.targets
    assert len(targets) == len(times_ns)
    for time_ns, target in zip(times_ns, targets, strict=True):
        expected = motion.trajectory.at(time_ns - begin_ns)
        for part, wanted in zip(target, expected, strict=True):
            np.testing.assert_allclose(part, wanted, atol=1e-9)
    # By differences of positions over the robot's own cycle, in true time. Where jerk switches
    # between two samples, parts in ten thousand are allowed for.
    q, h = np.array([target.q for target in targets]), period_ns / 1e9
    for order, bound in ((1, LAB.velocity), (2, LAB.acceleration), (3, LAB.jerk)):
        peak = np.abs(np.diff(q, n=order, axis=0)).max(axis=0) / h**order
        assert (peak <= bound * (1 + 1e-3)).all(), (order, peak / bound)


def test_cycles_that_were_lost_are_left_out() -> None:
    """The plan goes on in the robot's time; it is not late for ever after."""
    robot = LoneRobot(holding(), LAB)
    motion = StartMotion(HOME, HOME + 0.05, LAB).trajectory
    robot.requests.arm(OURS, 0)
    stamp = robot.due + 3
    assert robot.controller.receive(robot.payload(motion, stamp), OURS, 1, 0)
    robot.run(10)
    robot.backend._time_ns += 2 * GRID_NS  # type: ignore[attr-defined]
    robot.run(1)
    due = robot.controller.arm_motion.executed_ns - stamp * GRID_NS
    np.testing.assert_array_equal(robot.targets[-1].q, motion.at(due).q)


@given(delay=st.integers(0, 20), ticks=st.integers(1, 40))
@settings(deadline=None)
def test_a_command_shows_after_its_delay(delay: int, ticks: int) -> None:
    backend = holding(delay_s=delay * GRID_NS / 1e9)
    robot = LoneRobot(backend, LAB)
    robot.requests.arm(OURS, 0)
    motion = StartMotion(HOME, HOME + 0.05, LAB).trajectory
    assert robot.controller.receive(robot.payload(motion, robot.due), OURS, 1, 0)
    robot.run(ticks)
    # In the cycle after a command at the earliest.
    shown = ticks - 1 - max(delay, 1)
    expected = HOME if shown < 0 else motion.point(shown).q
    np.testing.assert_array_equal(robot.measured[:7], expected)


# By name.


def test_every_robot_of_the_registry_can_be_made() -> None:
    for name in BACKENDS:
        assert make_backend(name, BackendOptions()).name == name
    with pytest.raises(NotFoundError, match=", ".join(BACKENDS)):
        make_backend("r2d2", BackendOptions())


def test_options_of_other_robots_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="nothing that varies"):
        make_backend("hold", BackendOptions(variation="randomised"))
    with pytest.raises(ConfigurationError, match="--variation instead"):
        make_backend("sim", BackendOptions(delay_s=0.01))
    for delay_s in (-1.0, float("nan"), 11.0):
        with pytest.raises(ConfigurationError, match="delay"):
            make_backend("hold", BackendOptions(delay_s=delay_s))
