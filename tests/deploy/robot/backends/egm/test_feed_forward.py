"""The bridge with feed-forward: positions that are sent run ahead of the plan, within limits."""

from __future__ import annotations

import numpy as np
from egm_bench import LAB, Bench, in_degrees
from egm_wire import MOTORS_OFF
from unknown_robots import exact_calibration

from skewmi.calibration.calibration_use import servo_constants
from skewmi.robot_models.feed_forward import FeedForward
from skewmi.trajectory import GRID_S, Array


def law() -> FeedForward:
    constants = servo_constants(exact_calibration(0.5, 1.4, 0.2))
    assert constants is not None
    return FeedForward(constants, LAB)


def moved(bench: Bench, joint: int) -> tuple[Array, list[tuple[float, ...]]]:
    """What one axis' motion is answered with: degrees, shape (cycles, 7), and speeds."""
    bench.armed()
    start = np.array(bench.robot.arm_motion.commanded_position())
    goal = start.copy()
    goal[joint] += 0.1
    bench.send_chunk(bench.motion(start, goal).trajectory)
    answers = bench.run(500)
    return in_degrees(answers), [tuple(a.speeds) for a in answers if a.speeds]


def test_positions_are_the_law_of_the_plan_and_speeds_stay_the_plans() -> None:
    with Bench() as plain, Bench(feed_forward=law()) as known:
        plan, plan_speeds = moved(plain, 3)
        sent, speeds = moved(known, 3)
    assert speeds == plan_speeds
    lead = np.abs(sent - plan)[:, 3].max()
    assert lead > 1.0
    assert np.abs(np.delete(sent - plan, 3, axis=1)).max() < 1e-9
    # At rest it has come to the plan, but for friction that is being forgotten.
    np.testing.assert_allclose(sent[-1], plan[-1], atol=np.degrees(2e-3))
    for order, bound in enumerate((LAB.velocity, LAB.acceleration, LAB.jerk), 1):
        found = np.abs(np.diff(np.radians(sent), n=order, axis=0)) / GRID_S**order
        assert np.all(found <= bound * (1.0 + 1e-6))


def test_an_arm_that_was_not_guided_begins_at_rest() -> None:
    with Bench(feed_forward=law()) as bench:
        moved(bench, 3)
        bench.run(5, motors=MOTORS_OFF)
        bench.ready()
        answers = in_degrees(bench.run(20))
    assert np.ptp(answers, axis=0).max() < 1e-9
