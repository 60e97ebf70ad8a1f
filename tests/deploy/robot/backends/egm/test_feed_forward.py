"""The bridge with feed-forward: positions that are sent run ahead of the plan, within limits."""

from __future__ import annotations

import numpy as np
import pytest
from egm_bench import LAB, Bench, in_degrees
from egm_wire import MOTORS_OFF
from unknown_robots import exact_egm_calibration

from skewmi.calibration.calibration_use import low_pass_s, servo_constants
from skewmi.deploy.robot.backends.egm.leading import LeadingReferences
from skewmi.deploy.robot.backends.egm.telling import runs_on
from skewmi.deploy.robot.states import ServerState
from skewmi.robot_models.feed_forward import FeedForward
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import GRID_NS, GRID_S, Array


def law() -> LeadingReferences:
    known = exact_egm_calibration(low_pass_hz=5.0, lag_ms=40.0)
    constants = servo_constants(known)
    assert constants is not None
    return LeadingReferences(FeedForward(constants, LAB), low_pass_s(known), 0.186)


def moved(bench: Bench, joint: int) -> tuple[Array, list[tuple[float, ...]]]:
    """What one axis' motion is answered with: degrees, shape (cycles, 7), and speeds."""
    bench.armed()
    start = np.array(bench.robot.arm_motion.commanded_position())
    goal = start.copy()
    goal[joint] += 0.1
    bench.send_chunk(bench.motion(start, goal).trajectory)
    answers = bench.run(500)
    return in_degrees(answers), [tuple(a.speeds) for a in answers if a.speeds]


def test_references_run_ahead_of_the_plan_and_come_to_it() -> None:
    with Bench() as plain, Bench(leading=law()) as known:
        plan, plan_speeds = moved(plain, 3)
        sent, speeds = moved(known, 3)
    # 40 ms of the way, and as much of the acceleration as lag and low-pass ask for.
    assert np.abs(sent - plan)[:, 3].max() > 0.3
    ahead = np.array(speeds)[:, :7] - np.array(plan_speeds)[:, :7]
    assert np.abs(ahead).max() > 1.0
    assert np.abs(np.delete(sent - plan, 3, axis=1)).max() < 1e-9
    # At rest it has come to the plan, but for friction that is being forgotten.
    np.testing.assert_allclose(sent[-1], plan[-1], atol=np.degrees(2e-3))
    for order, bound in enumerate((LAB.velocity, LAB.acceleration, LAB.jerk), 1):
        found = np.abs(np.diff(np.radians(sent), n=order, axis=0)) / GRID_S**order
        assert np.all(found <= bound * (1.0 + 1e-6))


@pytest.mark.parametrize("after", range(0, 60, 7))
def test_an_arm_that_is_held_is_not_pulled_at_by_what_runs_ahead(after: int) -> None:
    """The plan steps to where it is held; so does what is sent, at once and for good."""
    with Bench(leading=law()) as bench:
        bench.armed()
        start = np.array(bench.robot.arm_motion.commanded_position())
        goal = start + 0.9 * (np.arange(7) == 4)
        # Longer than a chunk may be, so it is put where accepted ones go.
        robot, motion = bench.robot.arm_motion, bench.motion(start, goal).trajectory
        stamp_ns = robot.executed_ns - robot.executed_ns % GRID_NS + 3 * GRID_NS
        robot.plan.splice(stamp_ns, motion, robot.executed_ns)
        bench.run(after)
        while bench.robot.state is not ServerState.FAULT:
            bench.run(1, follow=False)
        assert "from its command" in bench.robot.machine.reason
        held = np.degrees(robot.measured)
        bench.requests.stop("test")
        for answer in bench.run(50, follow=False):
            np.testing.assert_allclose(answer.chain(), held, atol=1e-6)


def test_an_arm_that_was_not_guided_begins_at_rest() -> None:
    with Bench(leading=law()) as bench:
        moved(bench, 3)
        bench.run(5, motors=MOTORS_OFF)
        bench.ready()
        answers = in_degrees(bench.run(20))
    assert np.ptp(answers, axis=0).max() < 1e-9


def test_what_runs_on_is_reckoned_with_the_speeds_that_were_sent() -> None:
    """They are ahead of the plan's where it accelerates."""
    arm = ArmKinematics("right")
    with Bench(leading=law()) as bench:
        bench.armed()
        start = np.array(bench.robot.arm_motion.commanded_position())
        goal = start + 0.1 * (np.arange(7) == 0)
        bench.send_chunk(bench.motion(start, goal).trajectory)
        seconds = bench.options.program.runs_on_s(bench.options.feed_forward)
        told, sent, planned = [], [], []
        for _ in range(150):
            (answer,) = bench.run(1)
            v = np.radians(answer.speeds[0]) / bench.options.feed_forward * (np.arange(7) == 0)
            q = bench.backend.command.q
            sent.append(float(np.linalg.norm(arm.jacobian(q)[:3] @ v)))
            planned.append(float(np.linalg.norm(arm.jacobian(q)[:3] @ bench.backend.command.v)))
            told.append(runs_on(bench.backend) / seconds)
    assert (np.array(told) >= np.array(sent) * (1.0 - 1e-6)).all()
    assert (np.array(sent) > np.array(planned) + 1e-3).any(), "nothing was ahead of the plan"
